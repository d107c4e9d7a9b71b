"""From a measurement and a PSF on disk to pictures on disk."""

from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from nolens.camera import arrange_rgb, exposure_white
from nolens.files import write_png, write_state, write_tiff16, write_tiff32
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.read import developed, read_development, read_measurement
from nolens.jobs.reconstruction.resume import about_run, resumed
from nolens.jobs.reconstruction.sequence import reconstruct_sequence
from nolens.jobs.reconstruction.solve import method_of, reconstructor_of
from nolens.jobs.reconstruction.window import asked_region, crop_window, oriented
from nolens.jobs.run import Product, Run, Writer, announce_memory, job
from nolens.solvers import Method, Progress, admm_bytes


@job
def reconstruct(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Radiance of the part that was written, (channels, height, width); a sequence's last one.

    Where the measurement is a sequence of frames (a folder, a stack), see `reconstruct_sequence`.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    if options.is_sequence:
        return reconstruct_sequence(run)
    options.check_single()
    method = method_of(options)

    development = read_development(options)
    frame = read_measurement(options, options.measurement)
    options, ready = developed(options, development, frame, reporter)
    measurement, prepared = ready.measurement, ready.prepared
    psf = prepared.values
    region = asked_region(options, measurement.size, psf)
    for text in prepared.notes:
        reporter.note(text)
    run.warn(*prepared.warnings)

    reconstructor = reconstructor_of(options, psf, region, run.device)
    stop, tau = reconstructor.limits, reconstructor.weight
    problem = reconstructor.problem(measurement)
    window = crop_window(options, problem)
    announce_memory(admm_bytes(problem.padded_pixels), reporter)
    state, about = None, about_run(options, run.inputs, tau)
    if method is Method.ADMM:
        state = resumed(problem, options, about)

    def watch(progress: Progress) -> bool:
        return reporter.progress(progress, stop.iterations)

    result = reconstructor.solve(problem, state=state, callback=watch)
    top, left, height, width = window
    scene = result.scene[:, top : top + height, left : left + width].cpu()
    picture = oriented(scene, options.flip)
    white = exposure_white(picture)  # An empty picture is an error before anything is written.

    interrupted = result.stop_reason == "callback"
    shown = arrange_rgb(picture, measurement.channels)
    writers: dict[Path, Writer] = {
        path: partial(_write, picture=shown, white=white, options=options)
        for path in options.output
    }
    if interrupted and state is not None:
        writers[options.state] = partial(write_state, arrays=state.arrays(), about=about)
    figures = {
        "method": method.value,
        "iterations": result.iterations,
        "stop_reason": "interrupted" if interrupted else result.stop_reason,
        "objective": result.objective,
        "tau": tau,
        "default_tau": options.tau is None,
    }
    parameters = {
        "bin": options.bin_by,
        "black": development.black,
        "tau": tau,
        "iterations": stop.iterations,
        "tolerance": stop.tolerance,
        "scene_tolerance": stop.scene_tolerance,
        "low_frequency": stop.low_frequency,
        "period": list(problem.forward.geometry.padded),
        "channel_names": list(measurement.channels),
        "threads": torch.get_num_threads(),
    }
    return Product(picture, figures, writers, parameters, result.history)


def _write(path: Path, picture: Tensor, white: float, options: ReconstructOptions) -> None:
    if path.suffix.lower() == ".png":
        write_png(path, picture, white)
    elif options.tiff_bits == 16:
        write_tiff16(path, picture)
    else:
        write_tiff32(path, picture)
