"""From measurements of known pictures to a PSF in the camera's folder."""

from collections.abc import Callable
from functools import partial
from typing import Any

import torch

from nolens.calibrate.psf_from_scenes import SolvedPsf, psf_from_scenes, unexplained
from nolens.camera import PsfEntry
from nolens.errors import DataError, OptionError
from nolens.evaluate import affine_fit, psnr, ssim
from nolens.experiments.virtual_experiment import solved
from nolens.files import (
    CAMERA_FILE,
    InputFile,
    RunRecord,
    camera_files,
    check_folder,
    readable,
    write_psfs,
    write_record,
)
from nolens.jobs.calibration.folder import CalibratedPsf, cell_of, folder_camera, folder_psfs
from nolens.jobs.calibration.pairs_options import CalibratePairsOptions, named_pairs
from nolens.jobs.calibration.pairs_read import ReadPairs, read_pairs
from nolens.jobs.clock import Clock
from nolens.jobs.cost import Cost, announce, check_memory
from nolens.jobs.given import check_apart
from nolens.jobs.reporter import Reporter

_ILL_POSED = 3
_LIKE_NONE = 0.95
_UNLIKE_THE_OTHERS = 1.3
_ITERATIONS, _TAU = 100, 1e-4
_SMALLEST = 16
_WINDOW = 11
# As the DiffuserCam pairs showed on two cores, for each cell of sensor and picture and channel of a
# pair.
_BYTES_PER_CELL, _SECONDS_PER_CELL = 150.0, 7e-6


def calibrate_pairs(options: CalibratePairsOptions, reporter: Reporter) -> CalibratedPsf:
    """Solve the PSF that explains measurements of known pictures, and add it to a folder.

    Parameters
    ----------
    options
        What to read, where the pictures were, where to write.
    reporter
        Sees warnings and how far the work is.

    Raises
    ------
    NolensError
        If a file, an option or the folder cannot be used; then nothing is written.
    """
    clock = Clock()
    check_folder(options.output)
    pairs = named_pairs(options.measured, options.pictures)
    names = list(pairs)
    if options.check and len(names) < 2:
        raise OptionError("--check solves without each pair in turn, and there is only one")
    files = dict(options.inputs)
    for name, (measured, picture) in pairs.items():
        files |= {f"measurement {name}": measured, f"picture {name}": picture}
    opened, psfs = folder_camera(options.output), folder_psfs(options.output)
    if opened is not None:
        files |= camera_files(options.output / CAMERA_FILE, opened.camera)
    check_apart(options, files)
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    read = read_pairs(options, pairs)
    cell = cell_of(read.first, opened, psfs, options.pixel)
    channels = read.channels if options.each_channel else ("grey",)
    if psfs is not None and psfs.psf[0].channels != channels:
        raise OptionError(
            f"the PSF {psfs.psf[0].file} of the folder has the channels "
            f"{', '.join(psfs.psf[0].channels)}, but this one would have {', '.join(channels)}: "
            "give another folder (-o)"
            + ("" if options.each_channel else ", or solve each channel (--each-channel)")
        )
    entry = PsfEntry(
        file=options.psf.name,
        cell=cell,
        channels=channels,
        distance=options.distance,
        kind="solved",
    )
    rounds = 1 + (len(names) if options.check else 0)
    cost, device = _cost(read, rounds), torch.device("cpu")
    check_memory(cost, device, "fewer or smaller pictures need less")
    announce(cost, device, reporter)

    def tick(number: int) -> Callable[[float], None]:
        return lambda share: reporter.advance("PSF", (number + share) / rounds)

    found = _solved(read, names, options, tick(0))
    psf = torch.stack([each.psf for each in found])
    checks = [
        _left_out(read, names, left, options, tick(1 + number))
        for number, left in enumerate(names if options.check else [])
    ]
    rows = _rows(read, names, found)
    warnings = _doubts(rows)
    for text in warnings:
        reporter.warn(text)
    summary = {
        "camera": None if opened is None else opened.camera.name,
        **entry.model_dump(mode="json"),
        "cells": list(psf.shape[-2:]),
        "support_share": round(float(found[0].support.double().mean()), 4),
        "pairs": rows,
        "left_out": checks,
        "warnings": warnings,
        "outputs": [readable(path) for _, path, _ in options.written],
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
    more = {options.record.name: partial(write_record, record=record)}
    write_psfs(options.output, {entry: psf}, more=more)
    return CalibratedPsf(psf, entry, summary)


def _groups(read: ReadPairs, options: CalibratePairsOptions) -> list[list[int]]:
    """Channels that have a PSF in common."""
    every = list(range(len(read.channels)))
    return [[each] for each in every] if options.each_channel else [every]


def _solved(
    read: ReadPairs,
    names: list[str],
    options: CalibratePairsOptions,
    tick: Callable[[float], None],
) -> list[SolvedPsf]:
    """A PSF for each group of channels, of some of the pairs."""
    groups = _groups(read, options)
    found = []
    for number, group in enumerate(groups):

        def advance(share: float, number: int = number) -> None:
            tick((number + share) / len(groups))

        found.append(psf_from_scenes(read.known(names, group), tick=advance))
    return found


def _left_out(
    read: ReadPairs,
    names: list[str],
    left: str,
    options: CalibratePairsOptions,
    tick: Callable[[float], None],
) -> dict[str, Any]:
    """How well a pair is explained and reconstructed with the PSF of the others."""
    others = [name for name in names if name != left]
    psf = torch.stack([each.psf for each in _solved(read, others, options, tick)])
    groups = _groups(read, options)
    misfit = torch.cat(
        [
            unexplained(read.known([left], group), plane)
            for group, plane in zip(groups, psf, strict=True)
        ]
    )
    truth = read.pictures[left]
    scene = solved(read.measured[left], psf, read.region, iterations=_ITERATIONS, tau=_TAU)
    peak = float(truth.max())
    shown = affine_fit(scene, truth).clamp(0, peak)
    large = min(truth.shape[-2:]) >= _WINDOW
    return {
        "name": left,
        "misfit": [round(each, 4) for each in misfit.tolist()],
        "psnr_db": round(psnr(shown, truth, peak), 3),
        "ssim": round(ssim(shown, truth, peak), 4) if large else None,
    }


def _rows(read: ReadPairs, names: list[str], found: list[SolvedPsf]) -> list[dict[str, Any]]:
    """What the solution says of each pair, channel by channel."""
    many = len(read.channels) // len(found)

    def of(number: int, figures: str) -> list[float]:
        return [
            round(float(getattr(each, figures)[number * many + channel]), 4)
            for each in found
            for channel in range(many)
        ]

    return [
        {
            "name": name,
            "gain": of(number, "gains"),
            "misfit": of(number, "misfit"),
            "misfit_varying": of(number, "misfit_varying"),
        }
        for number, name in enumerate(names)
    ]


def _doubts(rows: list[dict[str, Any]]) -> list[str]:
    doubts = []
    if len(rows) < _ILL_POSED:
        doubts.append(
            f"{len(rows)} pair{'' if len(rows) == 1 else 's'} can be explained by many PSFs: take "
            "five or more, of pictures with much detail"
        )
    means = [sum(row["misfit"]) / len(row["misfit"]) for row in rows]
    middle = sorted(means)[len(means) // 2]
    for row, mean in zip(rows, means, strict=True):
        if mean > _LIKE_NONE or (len(rows) > 2 and mean > _UNLIKE_THE_OTHERS * middle):
            doubts.append(
                f"the pair {row['name']} is explained badly ({100 * mean:.0f} % of its measurement "
                f"is left, {100 * middle:.0f} % of the others): is that the picture that was "
                "shown, in its place and not turned?"
            )
    return doubts


def _cost(read: ReadPairs, rounds: int) -> Cost:
    sensor = read.measured[next(iter(read.measured))].values
    rows, columns = sensor.shape[-2] + read.region.height, sensor.shape[-1] + read.region.width
    if min(sensor.shape[-2:]) < _SMALLEST or min(read.region.height, read.region.width) < _SMALLEST:
        raise DataError(
            f"the sensor has {sensor.shape[-2]}×{sensor.shape[-1]} cells and the pictures "
            f"{read.region.height}×{read.region.width}: give at least {_SMALLEST} in each direction"
        )
    cells = rows * columns * len(read.measured) * sensor.shape[0]
    return Cost(cells * _BYTES_PER_CELL, cells * rounds * _SECONDS_PER_CELL)
