"""From a measurement, or a sequence of them, and a PSF on disk to pictures on disk."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import arrange_rgb, exposure_white
from nolens.errors import DataError, OptionError
from nolens.files import (
    InputFile,
    read_frame,
    read_state,
    write_png,
    write_state,
    write_tiff16,
    write_tiff32,
)
from nolens.files.contact_sheet import SheetPicture, write_contact_sheet
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reconstruction.sequence import reconstruct_sequence
from nolens.jobs.reconstruction.setup import Setup, method_of, psf_row, read_development
from nolens.jobs.reconstruction.sweep import (
    SweptPicture,
    sweep_settings,
    sweep_writers,
    swept_options,
)
from nolens.jobs.reconstruction.video import reconstruct_video
from nolens.jobs.run import Product, Run, Writer, job
from nolens.solvers import AdmmState, Method, Problem, Progress, Stop
from nolens.solvers.explanation import picture_warnings
from nolens.solvers.inputs import tensor_of
from nolens.solvers.report import Report
from nolens.solvers.result import Result
from nolens.solvers.uncertainty import detail_warning, uncertainty

_BRIGHT = 0.995
"""Fraction of the values on a sheet that are not brighter than its white."""
_PROBLEM_OPTIONS = (
    "black",
    "white",
    "mosaic",
    "bgr",
    "detail",
    "bin",
    "channels",
    "support",
    "field",
    "camera",
)
"""Options that decide what problem is solved; how long and where may change."""


@job
def reconstruct(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Radiance of the part that was written, (channels, height, width); a sequence's last one.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    if run.options.depths is not None:
        from nolens.jobs.reconstruction.volume import reconstruct_volume

        return reconstruct_volume(run)
    if run.options.bands is not None:
        from nolens.jobs.reconstruction.bands import reconstruct_bands

        return reconstruct_bands(run)
    if run.options.is_sequence:
        return reconstruct_sequence(run)
    if run.options.latency is not None:
        raise OptionError(
            f"--latency {run.options.latency} bounds the frames of a sequence, and "
            f"{run.options.measurement} is one frame: leave it out, or give a folder or a stack of "
            "frames"
        )
    if run.options.frames is not None:
        return reconstruct_video(run)
    method_of(run.options)  # A contradiction is an error before anything is read.
    development = read_development(run)
    frame = read_frame(run.options.measurement, mosaic=run.options.mosaic, bgr=run.options.bgr)
    return _reconstruct_frame(run, Setup.of(run, development, frame))


def _reconstruct_frame(run: Run[ReconstructOptions], setup: Setup) -> Product[Tensor]:
    """The picture of one measurement."""
    options, reconstructor, problem = setup.options, setup.reconstructor, setup.problem
    stop = reconstructor.limits
    about = _about(setup, run.inputs)
    state = None
    if reconstructor.starts_coarse(problem):
        if options.resume is not None:
            raise OptionError(
                f"--resume {options.resume}: a picture by a trained prior keeps no state of where "
                "it stands: leave it out"
            )
    elif reconstructor.method is Method.ADMM:
        problem, state = _start(setup, about)
        setup = replace(setup, problem=problem)
    about["tau"] = tau = setup.tau

    def watch(progress: Progress) -> bool:
        return run.reporter.progress(progress, progress.end(stop.iterations))

    result = reconstructor.solve(problem, state=state, callback=watch)
    picture = setup.picture(result.scene)
    white = exposure_white(picture)  # An empty picture is an error before anything is written.
    interrupted = result.stop_reason == "callback"
    if not interrupted:
        state = None  # As large as all that follows.
    psf = tensor_of(reconstructor.psf, "PSF")
    run.warn(*picture_warnings(problem, result, psf, options.iterations))
    report = Report.of(
        problem,
        result,
        psf,
        # Held-out pixels were predicted by total variation.
        prediction=None if result.first is not None else setup.prediction,
        method=reconstructor.method_name,
        automatic_tau=options.tau == "auto",
        automatic_support=setup.light is not None,
        acceptance=setup.light is not None and setup.light.is_acceptance,
        seconds=run.clock.seconds,
        pixel_rad=setup.pixel_rad,
        left_out=setup.field.left_out,
    )
    doubt = detail_warning(result, report.frequency)
    run.warn(*([] if doubt is None else [doubt]))
    rgb = arrange_rgb(picture, setup.measurement.channels)
    write = partial(write_picture, white=white, options=options)
    writers: dict[Path, Writer] = {path: partial(write, picture=rgb) for path in options.output}
    if interrupted and state is not None:
        writers[options.state] = partial(write_state, arrays=state.arrays(), about=about)
    figures: dict[str, Any] = {
        "method": reconstructor.method_name,
        "iterations": result.iterations,
        "stop_reason": "interrupted" if interrupted else result.stop_reason,
        "objective": result.objective,
        "tau": tau,
        "automatic_tau": options.tau == "auto",
        "detail": options.detail,
        **setup.prior_facts,
        "report": report.summary(),
        "field_points": problem.forward.field_points,
        "automatic_support": setup.light is not None,
    }
    if options.sweep is not None and not interrupted:
        settings = sweep_settings(options, None, setup.measurement.size)
        swept = _sweep(run, setup, SweptPicture(None, settings, tau, result, rgb))
        writers |= sweep_writers(options, swept, white, write)
        figures["sweep"] = [each.row(options) for each in swept]
    if options.uncertainty is not None and not interrupted:
        writers |= _uncertainty(run, setup, problem, result, white)
    parameters = {
        "bin": options.bin_by,
        "black": setup.development.black,
        "psf": psf_row(setup.psf),
        "psfs_over_field": setup.field.row(),
        "tau": tau,
        "support": setup.support,
        "supports": [] if setup.light is None else [step.row() for step in setup.light.steps],
        "weights": [] if setup.weight is None else [step.row() for step in setup.weight.steps],
        **asdict(stop),
        "fft_grid": list(problem.forward.geometry.padded),
        "sensor": list(problem.forward.sensor),
        "window": setup.window_on_sensor,
        "channel_names": list(setup.measurement.channels),
        "threads": torch.get_num_threads(),
    }
    if setup.rectification is not None:
        parameters["rectification"] = setup.rectification.row()
    return Product(picture, figures, writers, parameters, result.history)


def _uncertainty(
    run: Run[ReconstructOptions], setup: Setup, problem: Problem, result: Result, white: float
) -> dict[Path, Writer]:
    """What writes the spread, and the sheet of it; nothing where it was interrupted."""
    count = setup.options.uncertainty
    assert count is not None

    def watch(fraction: float) -> bool:
        return run.reporter.step("% of the samples", round(100 * fraction), 100, "the picture")

    found = uncertainty(setup.reconstructor, problem, result, count, progress=watch)
    if found is None:
        return {}

    def seen(scene: Tensor) -> Tensor:
        return arrange_rgb(setup.picture(scene), setup.measurement.channels)

    pictures = [SheetPicture("picture", seen(result.scene))]
    writers: dict[Path, Writer] = {}
    values, difference, sheet = setup.options.uncertainty_files
    for path, what, scene in (
        (values, f"spread of {count} samples", found.spread),
        (difference, "difference from total variation", found.disagreement),
    ):
        if scene is not None:
            gain = white / _bright(seen(scene))
            pictures.append(SheetPicture(f"{what}, ×{gain:.2g}", gain * seen(scene)))
            writers[path] = partial(write_tiff32, radiance=seen(scene))
    writers[sheet] = partial(write_contact_sheet, pictures=pictures, white=white)
    return writers


def _bright(picture: Tensor) -> float:
    values = picture.flatten()
    return max(float(values[:: 1 + values.numel() // 10**6].quantile(_BRIGHT)), 1e-30)


def _sweep(run: Run[ReconstructOptions], setup: Setup, own: SweptPicture) -> list[SweptPicture]:
    """Pictures with other values of an option, in the sheet's order; up to where it was ended.

    Each starts cold, so that it is what its option alone gives. From the picture before, ADMM
    takes 12 to 200 iterations, and about 64 from its start (decision 13).
    """
    options, sensor = setup.options, setup.measurement.size
    psf = tensor_of(setup.reconstructor.psf, "PSF")
    others = [name for name in options.swept_names if name is not None]
    pictures: dict[str | None, SweptPicture] = {None: own}
    for number, name in enumerate(others):
        varied = setup.varied(run, swept_options(options, name, sensor), psf)
        watch = partial(_watch_sweep, run, number, len(others), varied.reconstructor.limits)
        result = varied.reconstructor.solve(varied.problem, callback=watch)
        if result.stop_reason == "callback":
            break
        picture = arrange_rgb(varied.picture(result.scene), setup.measurement.channels)
        settings = sweep_settings(options, name, sensor)
        pictures[name] = SweptPicture(name, settings, varied.problem.weight, result, picture)
    return [pictures[name] for name in options.swept_names if name in pictures]


def _watch_sweep(
    run: Run[ReconstructOptions], number: int, count: int, stop: Stop, progress: Progress
) -> bool:
    fraction = (number + progress.iteration / progress.end(stop.iterations)) / count
    return run.reporter.step("% of the sweep", round(100 * fraction), 100, "the pictures")


def write_picture(path: Path, picture: Tensor, white: float, options: ReconstructOptions) -> None:
    """Write a picture by the suffix of its file."""
    if path.suffix.lower() == ".png":
        write_png(path, picture, white)
    elif options.tiff_bits == 16:
        write_tiff16(path, picture)
    else:
        write_tiff32(path, picture)


def _about(setup: Setup, inputs: dict[str, InputFile]) -> dict[str, Any]:
    """What a run must have in common with one that goes on with its state."""
    values = setup.options.model_dump(mode="json")
    geometry = setup.development.psf_geometry
    return {
        **{role: file.sha256 for role, file in inputs.items()},
        "tau": setup.tau,
        **{name: values[name] for name in _PROBLEM_OPTIONS},
        **setup.prior_facts,
        "psf_scale": geometry.scale,
        "psf_extent": "wide" if geometry.extended else "sensor",
        "psf_flip": geometry.flip,
        "support": setup.support,
        "field_points": setup.problem.forward.field_points,
    }


def _start(setup: Setup, about: dict[str, Any]) -> tuple[Problem, AdmmState]:
    """The problem, and where to start: from the state file that --resume names, or cold.

    A state of a run with other files or options, or an edited one, is an error. With an automatic
    τ it has the run's.
    """
    options, problem = setup.options, setup.problem
    if options.resume is None:
        return problem, AdmmState.cold(problem, options.penalties)
    stored_tau: list[float] = []

    def check_run(stored: Mapping[str, Any]) -> None:
        before = _in_present_names(stored)
        here = dict(about)
        if options.tau == "auto":
            # Of an edited state, anything.
            tau = before.get("tau")
            if isinstance(tau, float) and 0 < tau < math.inf:
                here["tau"] = tau
                stored_tau.append(tau)
        names = sorted(name for name in {*here, *before} if here.get(name) != before.get(name))
        if names:
            known = [name for name in names if name in here] or ["option"]
            raise OptionError(
                f"{options.resume} is the state of a run with another {' and '.join(known)}; give "
                "the same files and options again, or leave out --resume"
            )

    state = AdmmState.cold(problem)
    try:
        arrays = read_state(options.resume, state.arrays(), check_run)
        if stored_tau:
            problem = problem.weighted(stored_tau[0])
            state = AdmmState.cold(problem)
        state.restore_(arrays)
    except DataError as error:
        raise OptionError(f"{options.resume} does not fit this run: {error}") from None
    return problem, state


def _in_present_names(stored: Mapping[str, Any]) -> dict[str, Any]:
    """What a state says of its run; the names of the version before are read too."""
    about = {"support" if key == "region" else key: value for key, value in stored.items()}
    if "psf_wider" in about:
        about["psf_extent"] = "wide" if about.pop("psf_wider") else "sensor"
    about.setdefault("detail", 1.0)
    about.setdefault("psf_flip", "none")
    about.setdefault("field_points", 1)
    return about
