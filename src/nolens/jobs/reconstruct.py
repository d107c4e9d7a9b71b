"""From a measurement and a PSF on disk to pictures on disk."""

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import (
    Frame,
    Measurement,
    PreparedPsf,
    arrange_rgb,
    dark_corner,
    develop,
    exposure_white,
    prepare_psf,
)
from nolens.errors import OptionError
from nolens.files import (
    InputFile,
    RunRecord,
    check_output,
    read_frame,
    readable,
    write_png,
    write_record,
    write_tiff16,
    write_tiff32,
    write_together,
)
from nolens.jobs.clock import Clock
from nolens.jobs.cost import Cost, duration_text
from nolens.jobs.device import pick_device
from nolens.jobs.given import check_apart
from nolens.jobs.options import Method, ReconstructOptions, parse_window
from nolens.jobs.reporter import Reporter
from nolens.operators import Region
from nolens.solvers import Problem, Result, admm, fista, wiener
from nolens.solvers.penalties import Balance
from nolens.solvers.result import Callback

_TAU = {Method.ADMM: 1e-4, Method.FISTA: 1e-4, Method.WIENER: 0.1}
_ITERATIONS = {Method.ADMM: 100, Method.FISTA: 300, Method.WIENER: 1}
_TOLERANCE = {Method.ADMM: 3e-4, Method.FISTA: 1e-4, Method.WIENER: 0.0}

# Per cell of the period and channel, as `make bench` saw them on two cores: the most memory that a
# run holds (in its first and last step), and what one iteration takes.
_BYTES_PER_CELL = 80
_SECONDS_PER_CELL = 1.5e-8


@dataclass(frozen=True)
class Outcome:
    """What a reconstruction came to.

    Parameters
    ----------
    picture
        Radiance of the part that was written, `(channels, height, width)`.
    summary
        Method, iterations, stop_reason, objective, seconds, device, outputs.
    """

    picture: Tensor
    summary: dict[str, Any]


def reconstruct(options: ReconstructOptions, reporter: Reporter) -> Outcome:
    """Read, solve and write; nothing is written unless all of it went well.

    Parameters
    ----------
    options
        What to read, how to solve, where to write.
    reporter
        Sees notes, warnings and every iteration.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used.
    """
    clock = Clock()
    for path in options.output:
        check_output(path, (".png", ".tif", ".tiff"))
    check_output(options.record, (".json",))
    check_apart(options, options.inputs)
    device = pick_device(options.device)

    black, measurement, prepared = _read(options)
    psf, warnings = prepared.values, list(prepared.warnings)
    inputs = {role: InputFile.of(path) for role, path in options.inputs.items()}
    sensor = (measurement.values.shape[-2], measurement.values.shape[-1])
    region = None if options.region is None else region_within(options.region, sensor, psf)
    for text in warnings:
        reporter.warn(text)

    tau = _TAU[options.method] if options.tau is None else options.tau
    problem = Problem.pose(
        psf.to(device),
        measurement.values.to(device),
        valid=measurement.valid.to(device),
        region=region,
        tau=tau,
        prior=options.prior,
    )
    window = _crop_window(options, problem, region)
    limit = _ITERATIONS[options.method] if options.iterations is None else options.iterations
    _announce(problem, limit, device, reporter)
    result = _solve(
        problem, options, limit, callback=lambda progress: reporter.progress(progress, limit)
    )
    top, left, height, width = window
    scene = result.scene[:, top : top + height, left : left + width].cpu()
    picture = oriented(scene, options.flip)
    exposure_white(picture)  # An empty picture is an error before anything is written.

    summary = {
        "method": options.method.value,
        "iterations": result.iterations,
        "stop_reason": "interrupted" if result.stop_reason == "callback" else result.stop_reason,
        "objective": result.objective,
        "seconds": clock.seconds,
        "device": str(device),
        "outputs": [readable(path) for path in (*options.output, options.record)],
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters={
            **options.model_dump(mode="json"),
            "black": black,
            "tau": tau,
            "iterations": limit,
            "tolerance": _tolerance(options),
            "period": list(problem.forward.geometry.period),
            "channel_names": list(measurement.channels),
            "threads": torch.get_num_threads(),
        },
        result=summary,
        history=result.history,
        warnings=warnings,
    )
    shown = arrange_rgb(picture, measurement.channels)
    writers = {path: partial(_write, picture=shown, options=options) for path in options.output}
    write_together({options.record: partial(write_record, record=record), **writers})
    return Outcome(picture=picture, summary=summary)


def _read(options: ReconstructOptions) -> tuple[float | None, Measurement, PreparedPsf]:
    """Black level (None: the files' own), measurement, and the PSF that fits it."""

    def read(path: Path) -> Frame:
        return read_frame(path, mosaic=options.mosaic, bgr=options.bgr)

    frame, psf_frame = read(options.measurement), _read_psf(options)
    dark = read(options.dark) if options.dark else None
    flat = read(options.flat) if options.flat else None
    black = dark_corner(psf_frame) if options.black == "auto" else options.black
    measurement = develop(
        frame, dark=dark, flat=flat, black=black, white=options.white,
        bin_by=options.bin, channels=options.channels,
    )  # fmt: skip
    # A dark frame of another size than the PSF's cannot be taken from it; its files' own black
    # level is then what there is.
    psf_dark = dark if dark and dark.counts.shape == psf_frame.counts.shape else None
    grey = psf_frame.mosaic is None and len(psf_frame.channels) == 1
    psf = develop(
        psf_frame, dark=psf_dark, black=black, white=options.white,
        bin_by=options.bin, channels="all" if grey else options.channels,
    )  # fmt: skip
    prepared = prepare_psf(psf, measurement, scale=options.psf_scale, wider=options.psf_wider)
    return black, measurement, prepared


def _read_psf(options: ReconstructOptions) -> Frame:
    """PSF, read like the measurement as far as its channels allow: it may be grey."""
    frame = read_frame(options.psf)
    if len(frame.channels) == 3:
        return read_frame(options.psf, bgr=True) if options.bgr else frame
    if options.mosaic is not None and frame.mosaic is None:
        return read_frame(options.psf, mosaic=options.mosaic)
    return frame


def region_within(text: str, sensor: tuple[int, int], psf: Tensor) -> Region:
    """Cells that light can come from; by far more than can be seen would only fill the memory.

    Parameters
    ----------
    text
        As --region has it.
    sensor
        (rows, columns) of the measurement.
    psf
        That it is reconstructed with.

    Raises
    ------
    OptionError
        If the text is no region, or one larger than can be seen.
    """
    region = parse_window(text, sensor, "--region")
    height, width = sensor[0] + psf.shape[-2], sensor[1] + psf.shape[-1]
    if region.height > height or region.width > width:
        raise OptionError(
            f"--region {text} is larger than what the sensor can see through this PSF; give at "
            f"most {height}x{width}, or leave it out for no limit"
        )
    return region


def _tolerance(options: ReconstructOptions) -> float:
    return _TOLERANCE[options.method] if options.tolerance is None else options.tolerance


def _solve(problem: Problem, options: ReconstructOptions, limit: int, callback: Callback) -> Result:
    if options.method is Method.WIENER:
        return wiener(problem)
    if options.method is Method.FISTA:
        return fista(problem, iterations=limit, tolerance=_tolerance(options), callback=callback)
    return admm(
        problem,
        iterations=limit,
        tolerance=_tolerance(options),
        penalties=options.penalties,
        balance=Balance() if options.balance else None,
        relaxation=options.relaxation,
        callback=callback,
    )


def solving_cost(problem: Problem, iterations: float) -> Cost:
    """What ADMM needs for a problem, as `make bench` saw it on two cores."""
    cells = math.prod(problem.forward.geometry.period) * problem.channels
    return Cost(cells * _BYTES_PER_CELL, cells * iterations * _SECONDS_PER_CELL)


def _announce(problem: Problem, limit: int, device: torch.device, reporter: Reporter) -> None:
    """Say beforehand what will take minutes or gigabytes."""
    height, width = problem.forward.geometry.period
    cost = solving_cost(problem, limit)
    gigabytes, seconds = cost.bytes / 1e9, cost.seconds
    if gigabytes > 1 or (seconds > 60 and device.type == "cpu"):
        reporter.note(
            f"{problem.channels} × {height}×{width} cells: about {gigabytes:.1f} GB of memory"
            + (f" and {duration_text(seconds)} on two cores" if device.type == "cpu" else "")
            + f" for {limit} iterations"
        )


def _crop_window(
    options: ReconstructOptions, problem: Problem, region: Region | None
) -> tuple[int, int, int, int]:
    """Rows and columns of the scene that are written: (top, left, height, width)."""
    geometry = problem.forward.geometry
    height, width = geometry.scene[2:]
    if options.crop == "all" or (options.crop is None and region is not None):
        return 0, 0, height, width
    wanted = (
        Region(0, 0, *problem.forward.sensor)
        if options.crop is None
        else parse_window(options.crop, problem.forward.sensor, "--crop")
    )
    top, left = wanted.top - geometry.origin[0], wanted.left - geometry.origin[1]
    if min(top, left) < 0 or top + wanted.height > height or left + wanted.width > width:
        raise OptionError(
            f"--crop {options.crop} reaches beyond the scene, which is {height}×{width} cells "
            f"from {geometry.origin[0]:+d}{geometry.origin[1]:+d}; give a part of that, or all"
        )
    return top, left, wanted.height, wanted.width


def oriented(picture: Tensor, flip: str) -> Tensor:
    """Picture (…, rows, columns) turned over as --flip asks for."""
    axes = {"none": (), "vertical": (-2,), "horizontal": (-1,), "both": (-2, -1)}[flip]
    return torch.flip(picture, axes) if axes else picture


def _write(path: Path, picture: Tensor, options: ReconstructOptions) -> None:
    if path.suffix.lower() == ".png":
        write_png(path, picture)
    elif options.tiff_bits == 16:
        write_tiff16(path, picture)
    else:
        write_tiff32(path, picture)
