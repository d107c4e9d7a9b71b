"""From a measurement and a PSF on disk to pictures on disk."""

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import arrange_rgb, exposure_white
from nolens.files import (
    InputFile,
    RunRecord,
    check_output,
    is_sequence,
    readable,
    write_png,
    write_record,
    write_state,
    write_tiff16,
    write_tiff32,
    write_together,
)
from nolens.jobs.clock import Clock
from nolens.jobs.device import pick_device
from nolens.jobs.options import check_apart
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.read import developed, read_development, read_measurement
from nolens.jobs.reconstruction.resume import about_run, resumed
from nolens.jobs.reconstruction.sequence import reconstruct_sequence
from nolens.jobs.reconstruction.solve import (
    announce_solving,
    method_of,
    reconstructor_of,
)
from nolens.jobs.reconstruction.window import asked_region, crop_window, oriented
from nolens.jobs.reporter import Reporter
from nolens.solvers import AdmmState, Method, Progress


@dataclass(frozen=True)
class Outcome:
    """What a reconstruction came to.

    Parameters
    ----------
    picture
        Radiance of the part that was written, `(channels, height, width)`; the last one's of a
        sequence.
    summary
        Method, iterations, stop_reason, objective, seconds, device, outputs; of a sequence, frames
        and dropped frames.
    """

    picture: Tensor = field(repr=False)
    summary: dict[str, Any]


def reconstruct(options: ReconstructOptions, reporter: Reporter) -> Outcome:
    """Read, solve and write; nothing is written unless all of it went well.

    Where the measurement is a sequence of frames (a folder, a stack), see `reconstruct_sequence`.

    Parameters
    ----------
    options
        What to read, how to solve, where to write.
    reporter
        Sees notes, warnings and every look.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used.
    """
    if is_sequence(options.measurement):
        return Outcome(*reconstruct_sequence(options, reporter))
    clock = Clock()
    for path in options.output:
        check_output(path, (".png", ".tif", ".tiff"))
    check_output(options.record, (".json",))
    check_apart(options, options.inputs)
    options.check_single()
    method, device = method_of(options), pick_device(options.device)

    development = read_development(options)
    frame = read_measurement(options, options.measurement)
    options, ready = developed(options, development, frame, reporter)
    measurement, prepared = ready.measurement, ready.prepared
    psf, warnings = prepared.values, list(prepared.warnings)
    inputs = {role: InputFile.of(path) for role, path in options.inputs.items()}
    region = asked_region(options, measurement.size, psf)
    for text in prepared.notes:
        reporter.note(text)
    for text in warnings:
        reporter.warn(text)

    reconstructor = reconstructor_of(options, psf, region, device)
    stop, tau = reconstructor.limits, reconstructor.weight
    problem = reconstructor.problem(measurement)
    window = crop_window(options, problem)
    announce_solving(problem, stop.iterations, device, reporter)
    state, about = None, about_run(options, inputs, tau)
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
    writers = {
        path: partial(_write, picture=shown, white=white, options=options)
        for path in options.output
    }
    kept = [options.state] if interrupted and state is not None else []
    summary = {
        "method": method.value,
        "iterations": result.iterations,
        "stop_reason": "interrupted" if interrupted else result.stop_reason,
        "objective": result.objective,
        "tau": tau,
        "seconds": clock.seconds,
        "device": str(device),
        "outputs": [readable(path) for path in (*options.output, options.record, *kept)],
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters={
            **options.model_dump(mode="json"),
            "bin": options.bin_by,
            "black": development.black,
            "tau": tau,
            "iterations": stop.iterations,
            "tolerance": stop.tolerance,
            "scene_tolerance": stop.scene_tolerance,
            "smooth_part": stop.smooth_part,
            "period": list(problem.forward.geometry.period),
            "channel_names": list(measurement.channels),
            "threads": torch.get_num_threads(),
        },
        result=summary,
        history=result.history,
        warnings=warnings,
    )

    def finish(path: Path) -> None:
        summary["seconds"] = record.result["seconds"] = clock.seconds  # With all that was written.
        write_record(path, record)

    states = {path: partial(write_state, arrays=_arrays(state), about=about) for path in kept}
    write_together({**writers, **states, options.record: finish})
    return Outcome(picture=picture, summary=summary)


def _arrays(state: AdmmState | None) -> dict[str, Tensor]:
    return {} if state is None else state.arrays()


def _write(path: Path, picture: Tensor, white: float, options: ReconstructOptions) -> None:
    if path.suffix.lower() == ".png":
        write_png(path, picture, white)
    elif options.tiff_bits == 16:
        write_tiff16(path, picture)
    else:
        write_tiff32(path, picture)
