"""From a captured PSF and ordinary pictures to a PSF that goes on beyond the sensor."""

from functools import partial

import torch
from torch import Tensor

from nolens.calibrate.surround import PSF_STEPS, SCENE_STEPS, Extended, extend, filled, steps
from nolens.camera import Measurement, PsfEntry, PsfSet, develop
from nolens.errors import DataError, OptionError
from nolens.files import (
    PSFS_FILE,
    InputFile,
    RunRecord,
    read_frame,
    read_psf,
    read_psf_set,
    readable,
    write_psfs,
    write_record,
)
from nolens.jobs.calibration.folder import CalibratedPsf
from nolens.jobs.calibration.point_options import distance_name
from nolens.jobs.calibration.surround_options import CalibrateSurroundOptions
from nolens.jobs.clock import Clock
from nolens.jobs.cost import duration_text
from nolens.jobs.reconstruction.options import parse_window
from nolens.jobs.reporter import Reporter
from nolens.operators import Region

_TAU = 1e-5
_SECONDS_PER_CELL = 2e-8
"""For a step of either solver and one cell of the wide PSF, as seen on two cores."""
_LONG_S = 20


def calibrate_surround(options: CalibrateSurroundOptions, reporter: Reporter) -> CalibratedPsf:
    """Extend a captured PSF beyond the sensor, and add the result to its folder.

    Parameters
    ----------
    options
        Which folder, which pictures.
    reporter
        Sees warnings and how far the work is; can stop it after a round.

    Raises
    ------
    NolensError
        If the folder, a picture or an option cannot be used; then nothing is written.
    """
    clock = Clock()
    source = _source(options, read_psf_set(options.folder))
    psf = read_psf(options.folder, source)
    if not float(psf.sum()) > 0:
        raise DataError(f"{source.file} is dark: calibrate it again")
    sensor = (psf.shape[-2], psf.shape[-1])
    region = parse_window(options.region, sensor, "--region")
    _check_region(region, sensor)
    files = {f"PSF {source.file}": options.folder / source.file, **options.inputs}
    pictures = [_picture(options, number, psf, source) for number in range(len(options.pictures))]
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    wide = filled(psf, region)
    _announce(wide, options, reporter)
    stopped = False

    def step(done: int) -> bool:
        nonlocal stopped
        limit = steps(options.rounds, len(pictures))
        stopped = reporter.step("step", done, limit, "the PSF")
        return stopped

    found = Extended(wide, False, ())
    if pictures:
        step(0)
        found = extend(psf, pictures, region, rounds=options.rounds, tau=_TAU, step=step)
    warnings = _doubts(found)
    for text in warnings:
        reporter.warn(text)
    name = distance_name(source.distance)
    entry = PsfEntry(
        file=f"extended-{name}.tif",
        cell=source.cell,
        channels=source.channels,
        distance=source.distance,
        kind="extended",
        usable_per_mm=source.usable_per_mm,
    )
    record_file = f"extend-{name}.json"
    summary = {
        "folder": readable(options.folder),
        "from": source.file,
        "file": entry.file,
        "cells": list(found.psf.shape[-2:]),
        "region": [region.height, region.width],
        "surround": "pictures" if found.found else "mean light",
        "rounds": max(0, len(found.misfit) - 1),
        "misfit": [round(each, 7) for each in found.misfit],
        "interrupted": stopped,
        "warnings": warnings,
        "outputs": [
            readable(options.folder / each) for each in (entry.file, PSFS_FILE, record_file)
        ],
        "seconds": clock.seconds,
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json"),
        result=summary,
        history=[],
        warnings=warnings,
    )
    write_psfs(
        options.folder,
        {entry: found.psf},
        more={record_file: partial(write_record, record=record)},
    )
    return CalibratedPsf(found.psf, entry, summary)


def _source(options: CalibrateSurroundOptions, psfs: PsfSet) -> PsfEntry:
    """The captured PSF that is extended."""
    there = [each for each in psfs.by_distance(("captured",)) if each.frame == "chief-ray"]
    if not there:
        raise DataError(
            f"{options.folder} has no captured PSF of a light straight ahead: add one first, with "
            "nolens calibrate FRAME... --distance 300mm"
        )
    have = ", ".join(str(each.distance) for each in there)
    if options.distance is None and len(there) > 1:
        raise OptionError(
            f"{options.folder} has captured PSFs of several distances ({have}): say which is "
            "nearest to the pictures' (--distance)"
        )
    for each in there:
        if options.distance in (None, each.distance):
            return each
    raise OptionError(
        f"--distance {options.distance}: {options.folder} has captured PSFs of {have}; choose one"
    )


def _check_region(region: Region, sensor: tuple[int, int]) -> None:
    starts, sizes = (region.top, region.left), (region.height, region.width)
    for start, size, count in zip(starts, sizes, sensor, strict=True):
        if size > count or start + size <= 0 or start >= count:
            raise OptionError(
                f"--region {size} cells from cell {start} on: light must fall on the sensor's "
                f"{count} cells through the middle of the PSF, and cover no more of them than "
                "there are; nolens calibrate plan CAMERA --angle 56deg tells the region"
            )


def _picture(
    options: CalibrateSurroundOptions, number: int, psf: Tensor, source: PsfEntry
) -> Measurement:
    """What the sensor measured of a scene, on the PSF's cells."""
    # A grey PSF serves the mean of a picture's colours.
    grey = source.channels == ("grey",)
    found = develop(read_frame(options.pictures[number]), channels="grey" if grey else "all")
    if found.channels != source.channels:
        raise DataError(
            f"{found.source} has the channels {', '.join(found.channels)}, but the PSF "
            f"{source.file} {', '.join(source.channels)}: give raw frames of the same camera"
        )
    if found.values.shape != psf.shape:
        raise DataError(
            f"{found.source} has {found.size_text} cells, but the PSF {source.file} "
            f"{psf.shape[-2]}×{psf.shape[-1]}: give raw frames of the same camera, whole"
        )
    light = torch.where(found.valid, found.values, 0).sum(dim=(-2, -1))
    if not bool((light > 0).all()):
        raise DataError(f"{found.source} shows no light in at least one channel: leave it out")
    return found


def _announce(wide: Tensor, options: CalibrateSurroundOptions, reporter: Reporter) -> None:
    steps = options.rounds * (SCENE_STEPS + 2 * PSF_STEPS) * len(options.pictures)
    seconds = steps * wide.numel() * _SECONDS_PER_CELL
    if seconds > _LONG_S:
        reporter.note(f"this takes up to {duration_text(seconds)} on two cores")


def _doubts(found: Extended) -> list[str]:
    doubts = []
    if found.misfit and not found.found:
        share = 1 - found.misfit[1] / found.misfit[0]
        doubts.append(
            f"the pictures show too little of what lies beyond the sensor ({100 * share:.1f} % of "
            "what their reconstruction leaves over): it has the pattern's mean light. Captures at "
            "angles give more (nolens calibrate plan)"
        )
    return doubts
