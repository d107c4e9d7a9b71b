"""Frames of a point source and dark frames, read and told apart by their exposure times."""

import math
from dataclasses import dataclass, replace
from pathlib import Path

from nolens.calibrate.point_frames import (
    SAME_TIME,
    UNKNOWN_S,
    FrameMean,
    add_frame,
    check_alike,
    match_darks,
)
from nolens.camera import Frame, Sensor
from nolens.errors import DataError
from nolens.files import read_frame
from nolens.jobs.calibration.point_options import CalibratePointOptions
from nolens.jobs.reporter import Reporter


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
