"""`nolens calibrate`: frames of a point source become a PSF in a camera's folder."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.calibrate.point import (
    UNCERTAIN_RATIO,
    PointPsf,
    centroid,
    moved_to_middle,
    point_psf,
    point_psf_bytes,
)
from nolens.calibrate.point_frames import (
    SAME_TIME,
    UNKNOWN_S,
    FrameMean,
    add_frame,
    check_alike,
    match_darks,
)
from nolens.calibrate.point_register import NEARBY, register
from nolens.camera import Frame, PsfEntry, PsfSet, Sensor
from nolens.errors import DataError
from nolens.files import CAMERA_FILE, camera_files, read_frame, read_psf
from nolens.files.cameras import camera_copies
from nolens.jobs.calibration.folder import (
    added,
    cell_of,
    check_free,
    chosen_camera,
    folder_psfs,
)
from nolens.jobs.calibration.point_options import CalibratePointOptions
from nolens.jobs.run import Product, Reporter, Run, Writer, check_memory, job

_LEAST_ALIKE = 0.4
_MERGED_SHARE = 0.5
"""Of the work on a PSF; the rest brings it into its place."""
_LARGE_DEG, _LARGE_SHARE = 2.0, 0.05
_OFF_PREDICTED = 0.2
"""Of M − 1: twins are predicted to 2 %, the paper's own figures are two thirds off."""


@dataclass(frozen=True)
class ReadFrames:
    """What was read.

    Parameters
    ----------
    exposures
        Means of frames by exposure time in s.
    darks
        For each of these times, the mean of its dark frames; none where there are no dark frames.
    timed
        Whether the exposure times are known.
    warnings
        What a person should know.
    """

    exposures: dict[float, FrameMean]
    darks: dict[float, FrameMean]
    timed: bool
    warnings: tuple[str, ...]

    @property
    def first(self) -> Frame:
        """One of the frames."""
        return next(iter(self.exposures.values())).first


def read_frames(
    options: CalibratePointOptions, sensor: Sensor | None, reporter: Reporter
) -> ReadFrames:
    """Read all frames, and average those of one exposure time.

    Parameters
    ----------
    options
        They name the files.
    sensor
        The camera's, which says what files do not: mosaic, black and white level.
    reporter
        Sees how far the work is.

    Raises
    ------
    NolensError
        If a file cannot be read, or frames do not fit together.
    """
    total = len(options.frames) + len(options.dark)
    exposures: dict[float, FrameMean] = {}
    known: list[bool] = []
    for number, path in enumerate(options.frames):
        reporter.advance("frames", number / total)
        frame = _read(path, options, sensor)
        stated = options.exposure[number % len(options.exposure)].s if options.exposure else None
        time = frame.exposure_s if stated is None else stated
        known.append(time is not None)
        if known[-1] != known[0]:
            raise DataError(
                f"{path} says {'its' if known[-1] else 'no'} exposure time, but "
                f"{options.frames[0]} does {'not' if known[-1] else 'so'}: give the time of every "
                "frame (--exposure, once for each in their order)"
            )
        if number > 0:
            check_alike(frame, next(iter(exposures.values())).first)
        add_frame(exposures, frame, time)
    if not known[0]:
        _check_one_exposure(exposures[UNKNOWN_S])
    darks: dict[float, FrameMean] = {}
    for number, path in enumerate(options.dark, start=len(options.frames)):
        reporter.advance("frames", number / total)
        frame = _read(path, options, sensor)
        check_alike(frame, next(iter(exposures.values())).first, "dark frame")
        add_frame(darks, frame, frame.exposure_s or None, "dark frame")
    reporter.advance("frames", 1.0)
    warnings = [
        f"frames of {1e3 * time:g} ms differ by {100 * mean.uneven:.2g} % in brightness: a light "
        "that flickers, or settings that changed between them"
        for time, mean in exposures.items()
        if not mean.alike
    ]
    first = next(iter(exposures.values())).first
    if not darks and not first.black_stated:
        warnings.append(
            f"{first.source} does not say which count is black, and {first.black[0]:g} is taken: "
            "give dark frames (--dark), or a camera (--camera)"
        )
    if not math.isfinite(min(mean.white for mean in exposures.values())):
        warnings.append(
            f"{first.source} does not say from which count a pixel is saturated: make sure that "
            "none is"
        )
    matched = _matched(exposures, darks, known[0], warnings)
    return ReadFrames(exposures, matched, known[0], tuple(warnings))


def _read(path: Path, options: CalibratePointOptions, sensor: Sensor | None) -> Frame:
    frame = read_frame(path, mosaic=options.mosaic)
    if sensor is None:
        return frame
    whole = tuple(frame.counts.shape[-2:]) == (sensor.rows, sensor.columns)
    if frame.channels == ("grey",) and sensor.mosaic != "none" and whole:
        frame = replace(frame, channels=("mosaic",), mosaic=sensor.mosaic)
    if not frame.black_stated and len(frame.channels) == 1:
        white = min(sensor.saturated_counts, math.inf if frame.white is None else frame.white)
        frame = replace(frame, black=(sensor.black_counts,), white=white, black_stated=True)
    return frame


def _check_one_exposure(mean: FrameMean) -> None:
    if not mean.alike:
        raise DataError(
            f"the frames do not say their exposure times, and differ by {100 * mean.uneven:.3g} % "
            f"in brightness from {mean.first.source}: give the times (--exposure, once for each "
            "frame in their order), or frames of one exposure"
        )


def _matched(
    exposures: dict[float, FrameMean],
    darks: dict[float, FrameMean],
    timed: bool,
    warnings: list[str],
) -> dict[float, FrameMean]:
    """The dark frames that belong to each exposure time."""
    if not darks:
        return {}
    if not timed and len(darks) > 1:
        raise DataError(
            "the dark frames have several exposure times, and those of the frames are not known: "
            "give them (--exposure), or dark frames of the same time only"
        )
    found = match_darks(exposures, darks)
    for time, mean in found.items():
        own = mean.first.exposure_s
        same = own is not None and math.isclose(own, time, rel_tol=SAME_TIME)
        if timed and not same and own is not None:
            warnings.append(
                f"dark frames of {1e3 * own:g} ms are taken for frames of {1e3 * time:g} ms: where "
                "the sensor's dark current counts, take dark frames of every exposure time"
            )
    return found


@dataclass(frozen=True)
class Placed:
    """A PSF in its place.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    frame
        What its middle follows.
    figures
        How it was found, in values that JSON has.
    warnings
        What a person should know.
    """

    psf: Tensor
    frame: Literal["chief-ray", "sensor"]
    figures: dict[str, Any]
    warnings: list[str] = field(default_factory=list)


def placed(
    found: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    psfs: PsfSet | None,
    cell_um: float,
    tick: Callable[[float], None],
) -> Placed:
    """Bring a PSF into its place.

    One from straight ahead is laid over that of the nearest other distance in the folder, or
    else, where an aperture leaves a dark area, its light is centred; without one it stays where
    the sensor saw it. One from the side stays there as well, and one that is taken as it is.

    Parameters
    ----------
    found
        The PSF as it was captured.
    options
        They say where the light was.
    layers
        The camera's, if they are known.
    psfs
        What the folder has.
    cell_um
        Distance of the cells.
    tick
        Is told the share that is done.

    Raises
    ------
    DataError
        If the folder's PSFs are not of the same camera.
    """
    reference = _reference(options, psfs)
    other = None if reference is None else read_psf(options.output, reference)
    if reference is not None and other is not None and other.shape != found.psf.shape:
        raise DataError(
            f"the PSF {options.output / reference.file} has {other.shape[-2]}×{other.shape[-1]} "
            f"cells, but these frames {found.psf.shape[-2]}×{found.psf.shape[-1]}: they are of "
            "another camera or setting. Give another folder (-o)"
        )
    if options.as_is:
        return Placed(found.psf, "chief-ray", {"centred_by": "its file", "shift_um": [0.0, 0.0]})
    on_axis = all(each.deg == 0 for each in options.angle)
    if not on_axis:
        return _as_seen(found, options, layers, cell_um)
    if reference is not None and other is not None and _of_other_distance(reference, options):
        return _laid_over(found, options, layers, cell_um, reference, other, tick)
    if found.area is not None:
        dark = found.area.on_cells(*found.psf.shape[-2:])
        shift = centroid(found.psf, dark)
        return _moved(found, shift, {"centred_by": "centroid"}, layers, cell_um)
    return Placed(found.psf, "chief-ray", {"centred_by": "stated angle", "shift_um": [0.0, 0.0]})


def _reference(options: CalibratePointOptions, psfs: PsfSet | None) -> PsfEntry | None:
    """A captured PSF to compare with: of the nearest other distance, straight ahead if any is."""
    captured = [each for each in (psfs.psf if psfs else ()) if each.kind == "captured"]
    if not captured:
        return None
    here = _diopters(_um(options))
    return min(
        captured,
        key=lambda each: (
            not (each.on_axis and _of_other_distance(each, options)),
            abs(_diopters(each.distance_um) - here),
        ),
    )


def _of_other_distance(entry: PsfEntry, options: CalibratePointOptions) -> bool:
    return entry.on_axis and entry.frame == "chief-ray" and entry.distance != options.distance


def _laid_over(
    found: PointPsf,
    options: CalibratePointOptions,
    layers: Layers | None,
    cell_um: float,
    entry: PsfEntry,
    other: Tensor,
    tick: Callable[[float], None],
) -> Placed:
    expected = None
    if layers is not None:
        here, there = layers.magnification(_um(options)), layers.magnification(entry.distance_um)
        expected = here / there
    laid = register(found.psf, other, magnification=expected or NEARBY, tick=tick)
    if laid.correlation < _LEAST_ALIKE:
        raise DataError(
            f"the pattern is not that of {options.output / entry.file} in another size: their "
            f"correlation is {laid.correlation:.2f}, and less than {_LEAST_ALIKE:g} means another "
            "camera, another mask or a wrong distance. Give another folder (-o), or calibrate "
            f"{entry.distance} again"
        )
    figures: dict[str, Any] = {
        "centred_by": entry.file,
        "correlation": round(laid.correlation, 5),
        "magnification": round(laid.magnification, 6),
        "expected_magnification": None if expected is None else round(expected, 6),
    }
    place = _moved(found, laid.shift, figures, layers, cell_um)
    if expected is not None:
        off = abs(laid.magnification - expected)
        half = min(found.psf.shape[-2:]) / 2
        if off > _OFF_PREDICTED * abs(expected - 1) and off * half > 0.5:
            place.warnings.append(
                f"the pattern is {laid.magnification:.4f} times as large as that of "
                f"{entry.distance}, and the layers say {expected:.4f}: check both distances and "
                "the layers of the camera"
            )
    return place


def _moved(
    found: PointPsf,
    shift: tuple[float, float],
    figures: dict[str, Any],
    layers: Layers | None,
    cell_um: float,
) -> Placed:
    """The PSF with its light, which lies beside the middle by so many cells, in the middle."""
    psf = moved_to_middle(found.psf, shift)
    figures["shift_um"] = [_rounded(shift[1] * cell_um), _rounded(-shift[0] * cell_um)]
    place = Placed(psf, "chief-ray", figures)
    size = math.hypot(*shift)
    if layers is None:
        far, text = size > _LARGE_SHARE * min(psf.shape[-2:]), ""
    else:
        reduced = layers.before.reduced_um + layers.after.reduced_um
        angle = math.degrees(math.atan(size * cell_um / reduced))
        far, text = angle > _LARGE_DEG, f", as of a light {angle:.1f}° off the axis"
    if far:
        place.warnings.append(
            f"the pattern lies {size * cell_um:.0f} µm beside the middle{text}, and was moved "
            "there: if the light was not meant to be straight ahead, say where it was (--angle)"
        )
    return place


def _as_seen(
    found: PointPsf, options: CalibratePointOptions, layers: Layers | None, cell_um: float
) -> Placed:
    figures: dict[str, Any] = {"centred_by": "stated angle"}
    place = Placed(found.psf, "sensor", figures)
    if layers is None:
        return place
    expected = layers.shift_um(options.angle)
    figures["expected_shift_um"] = [_rounded(each) for each in expected]
    if found.area is None:
        return place
    row, column = centroid(found.psf, found.area.on_cells(*found.psf.shape[-2:]))
    seen = column * cell_um, -row * cell_um
    figures["shift_um"] = [_rounded(each) for each in seen]
    reduced = layers.before.reduced_um + layers.after.reduced_um
    off = math.degrees(math.atan(math.dist(seen, expected) / reduced))
    if off > _LARGE_DEG:
        place.warnings.append(
            f"the pattern lies {seen[0]:z.0f} µm to the right and {seen[1]:z.0f} µm up of the "
            f"middle, and by Snell's law an angle of {options.angle[0]}, {options.angle[1]} "
            f"puts it at {expected[0]:.0f} and {expected[1]:.0f}: about {off:.1f}° off. "
            "Check the angle, and that the whole pattern is on the sensor"
        )
    return place


def _um(options: CalibratePointOptions) -> float:
    return math.inf if options.distance == "infinity" else options.distance.um


def _diopters(distance_um: float) -> float:
    return 1e6 / distance_um


def _rounded(value: float) -> float:
    return round(value, 3) + 0.0


@job
def calibrate_point(run: Run[CalibratePointOptions]) -> Product[Tensor]:
    """Average, clean and centre frames of a point source, and add the PSF to a folder.

    Raises
    ------
    NolensError
        If a frame, an option or the folder cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    opened, copied = chosen_camera(options.output, options.camera)
    camera: dict[str, Writer] = {}
    if opened is not None:
        run.reads(camera_files(copied or options.output / CAMERA_FILE, opened.camera))
    if opened is not None and copied is not None:
        camera = camera_copies(copied, opened)
        check_free(options.output, list(camera))
    psfs = folder_psfs(options.output)

    frames = read_frames(options, None if opened is None else opened.camera.sensor, reporter)
    cell = cell_of(frames.first, opened, psfs, options.pixel)
    layers = None if opened is None else Layers.of_camera(opened.camera)
    needed = point_psf_bytes(frames.first.counts.numel(), len(frames.exposures))
    check_memory(needed, run.device, "frames of fewer exposure times need less")
    run.begin(needed)
    found = point_psf(
        frames.exposures,
        frames.darks,
        cell_um=cell.um,
        stray=options.stray_light,
        sensor=None if opened is None else opened.camera.sensor,
        as_is=options.as_is,
        tick=lambda share: reporter.advance("PSF", _MERGED_SHARE * share),
    )
    place = placed(
        found,
        options,
        layers,
        psfs,
        cell.um,
        lambda share: reporter.advance("PSF", _MERGED_SHARE + (1 - _MERGED_SHARE) * share),
    )
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
    run.warn(*frames.warnings, *_warnings(found, frames, usable, options.as_is), *place.warnings)
    figures = {
        "camera": None if opened is None else opened.camera.name,
        **entry.model_dump(mode="json"),
        "cells": list(place.psf.shape[-2:]),
        **_figures(found, frames),
        **place.figures,
    }
    return added(place.psf, figures, options.output, {entry: place.psf}, camera)


def _channels(frames: ReadFrames) -> tuple[str, ...]:
    return frames.first.channels if frames.first.mosaic is None else ("R", "G", "B")


def _warnings(found: PointPsf, frames: ReadFrames, usable: float, as_is: bool) -> list[str]:
    texts = []
    if found.saturated_share > 0:
        texts.append(
            f"{100 * found.saturated_share:.2g} % of the pixels are saturated in every exposure, "
            "and too dark there: a frame of a shorter exposure gives them back"
        )
    if found.area is None and not frames.darks and not as_is:
        texts.append(
            "the pattern fills the sensor, so that nothing tells stray light from its own: what "
            "there is stays in. Dark frames (--dark), with the room as it was and the point "
            "covered, take it away"
        )
    off = max(abs(ratio - 1) for ratio in found.ratios)
    if off > UNCERTAIN_RATIO:
        texts.append(
            f"the exposures are up to {100 * off:.2g} % off what their times say, and were "
            "corrected: the light or the shutter is not steady"
        )
    if usable <= 0:
        texts.append("the pattern's structure does not stand out of its noise: take more frames")
    return texts


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
