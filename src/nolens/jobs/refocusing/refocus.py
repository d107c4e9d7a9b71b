"""From one measurement and PSFs of several distances to pictures at any depth."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Measurement, develop
from nolens.files import (
    InputFile,
    RunRecord,
    check_folder,
    read_frame,
    readable,
    write_into,
    write_png,
    write_record,
    write_tiff16,
)
from nolens.jobs.clock import Clock
from nolens.jobs.cost import announce
from nolens.jobs.device import pick_device
from nolens.jobs.given import check_apart
from nolens.jobs.reconstruction.window import region_within
from nolens.jobs.refocusing.options import FOCUSED_FILES, RefocusOptions
from nolens.jobs.refocusing.psfs import DepthPsfs, read_depth_psfs
from nolens.jobs.refocusing.stack import Pages, stack_writers
from nolens.jobs.refocusing.work import RefocusWork, in_mm
from nolens.jobs.reporter import Reporter
from nolens.refocusing import Solving


@dataclass(frozen=True)
class RefocusOutcome:
    """What a refocusing came to.

    Parameters
    ----------
    picture
        Radiance at the depth that was asked for or found; None if only a stack was.
    pages
        The focal stack; None without one.
    summary
        Depths and figures, in values that JSON has.
    """

    picture: Tensor | None
    pages: Pages | None
    summary: dict[str, Any]


def refocus(options: RefocusOptions, reporter: Reporter) -> RefocusOutcome:
    """Read, find the depth, reconstruct and write; nothing is written unless all went well.

    Parameters
    ----------
    options
        What to read, which depths, where to write.
    reporter
        Sees notes, warnings and every look.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used.
    """
    clock = Clock()
    check_folder(options.output)
    check_apart(options, options.inputs)
    device = pick_device(options.device)
    measurement = _measured(options)
    psfs = read_depth_psfs(options, measurement)
    check_apart(options, {role: Path(each.path) for role, each in psfs.inputs.items()})
    work = RefocusWork(options, psfs, _solving(options, measurement, psfs, device), reporter)
    warnings = work.warnings()
    for text in warnings:
        reporter.warn(text)
    announce(work.cost(), device, reporter)
    inputs = {role: InputFile.of(path) for role, path in options.inputs.items()} | psfs.inputs

    summary: dict[str, Any] = {
        "depth_of_focus_per_m": psfs.depth_of_focus_per_m,
        "mask_to_sensor_um": psfs.between.reduced_um,
        "psf_distances_mm": [in_mm(each) for each in psfs.distances_um],
    }
    picture, pages, stopped = None, None, False
    writers: dict[Path, Callable[[Path], None]] = {}
    if options.focused:
        picture, found = work.focused()
        stopped = found is not None and not found.finished
        summary |= work.told(found)
        for text in work.doubts(found):
            warnings.append(text)
            reporter.warn(text)
        for name, write in zip(FOCUSED_FILES, (write_png, write_tiff16), strict=True):
            writers[options.output / name] = partial(write, radiance=picture)
    if options.stack is not None and not stopped:
        pages, stopped = work.stacked()
        summary["stack_mm"] = [in_mm(each) for each in pages.stack.depths_um]
        writers |= stack_writers(options.output, pages, f"{options.measurement.name} refocused")
    summary |= {
        "stop_reason": "interrupted" if stopped else "finished",
        "seconds": clock.seconds,
        "device": str(device),
        "outputs": [readable(path) for path in (*writers, options.record)],
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json"),
        result=summary,
        history=[],
        warnings=warnings,
    )
    writers[options.record] = partial(write_record, record=record)
    write_into(options.output, writers)
    return RefocusOutcome(picture, pages, summary)


def _measured(options: RefocusOptions) -> Measurement:
    read = partial(read_frame, mosaic=options.mosaic, bgr=options.bgr)
    frame = read(options.measurement)
    dark = read(options.dark) if options.dark else None
    flat = read(options.flat) if options.flat else None
    return develop(
        frame,
        dark=dark,
        flat=flat,
        black=options.black,
        white=options.white,
        bin_by=options.bin,
        channels=options.channels,
    )


def _solving(
    options: RefocusOptions, measurement: Measurement, psfs: DepthPsfs, device: torch.device
) -> Solving:
    sensor = measurement.values.shape[-2], measurement.values.shape[-1]
    region = None
    if options.region is not None:
        region = region_within(options.region, sensor, psfs.at(psfs.distances_um[-1]))
    return Solving(
        measurement, region, options.tau, options.prior, options.iterations, device=device
    )
