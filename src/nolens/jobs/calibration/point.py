"""From frames of a point source to a PSF in the camera's folder."""

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch

from nolens.calibrate.distances import Layers
from nolens.calibrate.point import UNCERTAIN_RATIO, PointPsf, point_psf
from nolens.camera import PsfEntry
from nolens.errors import DataError
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
from nolens.jobs.calibration.folder import (
    CalibratedPsf,
    cell_of,
    check_free,
    chosen_camera,
    folder_psfs,
)
from nolens.jobs.calibration.point_frames import ReadFrames, read_frames
from nolens.jobs.calibration.point_options import CalibratePointOptions
from nolens.jobs.calibration.point_place import placed
from nolens.jobs.clock import Clock
from nolens.jobs.copied import copied_camera
from nolens.jobs.cost import Cost, announce, check_memory
from nolens.jobs.given import check_apart
from nolens.jobs.reporter import Reporter

# As the paper's camera showed on two busy cores, with 4 frames of each of two exposure times.
_BYTES_PER_PIXEL, _BYTES_PER_EXPOSURE = 100, 40
_SECONDS_PER_PIXEL = 4e-6


def calibrate_point(options: CalibratePointOptions, reporter: Reporter) -> CalibratedPsf:
    """Average, clean and centre frames of a point source, and add the PSF to a folder.

    Parameters
    ----------
    options
        What to read, where the light was, where to write.
    reporter
        Sees warnings and how far the work is.

    Raises
    ------
    NolensError
        If a frame, an option or the folder cannot be used; then nothing is written.
    """
    clock = Clock()
    check_folder(options.output)
    opened, copied = chosen_camera(options.output, options.camera)
    files = dict(options.inputs)
    camera: dict[str, Callable[[Path], None]] = {}
    if opened is not None:
        files |= camera_files(copied or options.output / CAMERA_FILE, opened.camera)
    check_apart(options, files)
    if opened is not None and copied is not None:
        camera = copied_camera(copied, opened)
        check_free(options.output, list(camera))
    psfs = folder_psfs(options.output)

    frames = read_frames(options, None if opened is None else opened.camera.sensor, reporter)
    cell = cell_of(frames.first, opened, psfs, options.pixel)
    layers = None if opened is None else Layers.of_camera(opened.camera)
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    cost, device = _cost(frames), torch.device("cpu")
    check_memory(cost, device, "frames of fewer exposure times need less")
    announce(cost, device, reporter)
    reporter.advance("PSF", 0.0)
    found = point_psf(
        frames.exposures,
        frames.darks,
        cell_um=cell.um,
        stray=options.stray_light,
        sensor=None if opened is None else opened.camera.sensor,
        as_is=options.as_is,
    )
    reporter.advance("PSF", 0.5)
    place = placed(found, options, layers, psfs, cell.um)
    reporter.advance("PSF", 1.0)

    usable = min(band.usable_per_mm for band in found.bands)
    entry = PsfEntry(
        file=options.psf.name,
        cell=cell,
        channels=_channels(frames),
        distance=options.distance,
        angle=options.angle,
        kind="captured",
        frame=place.frame,
        usable_per_mm=round(usable, 2) if usable > 0 else None,
    )
    if psfs is not None and psfs.psf[0].channels != entry.channels:
        raise DataError(
            f"the PSF {psfs.psf[0].file} of the folder has the channels "
            f"{', '.join(psfs.psf[0].channels)}, but these frames {', '.join(entry.channels)}: "
            "give another folder (-o)"
        )
    warnings = [*frames.warnings, *_doubts(found, frames, usable, options.as_is), *place.warnings]
    for text in warnings:
        reporter.warn(text)
    summary = {
        "camera": None if opened is None else opened.camera.name,
        **entry.model_dump(mode="json"),
        "cells": list(place.psf.shape[-2:]),
        **_figures(found, frames),
        **place.figures,
        "warnings": warnings,
        "outputs": [
            *(readable(path) for _, path, _ in options.written),
            *(readable(options.output / name) for name in camera),
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
    camera[options.record.name] = partial(write_record, record=record)
    write_psfs(options.output, {entry: place.psf}, more=camera)
    return CalibratedPsf(place.psf, entry, summary)


def _cost(frames: ReadFrames) -> Cost:
    pixels = frames.first.counts.numel()
    return Cost(
        pixels * (_BYTES_PER_PIXEL + _BYTES_PER_EXPOSURE * len(frames.exposures)),
        pixels * _SECONDS_PER_PIXEL,
    )


def _channels(frames: ReadFrames) -> tuple[str, ...]:
    return frames.first.channels if frames.first.mosaic is None else ("R", "G", "B")


def _doubts(found: PointPsf, frames: ReadFrames, usable: float, as_is: bool) -> list[str]:
    doubts = []
    if found.saturated_share > 0:
        doubts.append(
            f"{100 * found.saturated_share:.2g} % of the pixels are saturated in every exposure, "
            "and too dark there: a frame of a shorter exposure gives them back"
        )
    if found.area is None and not frames.darks and not as_is:
        doubts.append(
            "the pattern fills the sensor, so that nothing tells stray light from its own: what "
            "there is stays in. Dark frames (--dark), with the room as it was and the point "
            "covered, take it away"
        )
    off = max(abs(ratio - 1) for ratio in found.ratios)
    if off > UNCERTAIN_RATIO:
        doubts.append(
            f"the exposures are up to {100 * off:.2g} % off what their times say, and were "
            "corrected: the light or the shutter is not steady"
        )
    if usable <= 0:
        doubts.append("the pattern's structure does not stand out of its noise: take more frames")
    return doubts


def _figures(found: PointPsf, frames: ReadFrames) -> dict[str, Any]:
    peak = float(found.psf.max())
    energy = found.psf.double().sum(dim=(-2, -1))
    peaks = found.psf.double().amax(dim=(-2, -1)).tolist()
    exposures = sorted(frames.exposures.items())
    return {
        "frames": sum(mean.count for _, mean in exposures),
        "exposures": [
            {
                "ms": round(1e3 * time, 6) if frames.timed else None,
                "frames": mean.count,
                "dark_frames": frames.darks[time].count if time in frames.darks else 0,
                "clipped_share": float(mean.clipped.double().mean()),
                "brightness": round(ratio, 6),
            }
            for (time, mean), ratio in zip(exposures, found.ratios, strict=True)
        ],
        "unit": "counts per second" if frames.timed else "counts of one frame",
        "peak": peak,
        "saturated_share": found.saturated_share,
        "frame_noise": {
            "read_counts": round(math.sqrt(found.noise.read_variance), 4),
            "counts_per_electron": round(found.noise.counts_per_electron, 5),
            "from": found.noise.known_from,
        },
        "noise_over_peak": [each / peak for each in found.noise_rms],
        "snr_db": [
            round(20 * math.log10(top / rms), 2) if top > 0 and rms > 0 else None
            for top, rms in zip(peaks, found.noise_rms, strict=True)
        ],
        "energy": (energy / energy.max()).tolist(),
        "contrast": round(found.contrast, 4),
        "dark_share": 0.0 if found.area is None else round(found.area.share, 4),
        "stray_over_peak": [each / peak for each in found.stray],
        "floor_over_peak": [each / peak for each in found.floor],
        "usable_per_mm_by_channel": [round(band.usable_per_mm, 2) for band in found.bands],
    }
