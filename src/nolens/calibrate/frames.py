"""Frames of one light, averaged by exposure time as they come."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from nolens.camera import MOSAICS, Frame, Sensor
from nolens.camera.measurement import saturation_count
from nolens.camera.values import unusable
from nolens.errors import DataError

_UNKNOWN_S = 1.0
"""Stands for the exposure time where none is known."""
_SAME_TIME = 2e-3
"""Relative difference up to which exposure times are one."""
_ALIKE = 0.05
"""Difference of brightness from which frames are not of one exposure."""


class FrameMean:
    """Mean of frames of the same light, taken with one exposure time.

    Frames are added one by one, so that only their sums are held. Every second one goes into a
    second sum: the difference of both shows the noise.

    Parameters
    ----------
    first
        The first frame; all others must have its size, colours, black and white level.
    role
        What the frames are, for messages.
    """

    def __init__(self, first: Frame, role: str = "frame") -> None:
        self.first, self.role = first, role
        self.sums = [torch.zeros_like(first.counts), torch.zeros_like(first.counts)]
        self.counts = [0, 0]
        self.clipped = torch.zeros_like(first.counts, dtype=torch.bool)
        self.levels: list[float] = []
        self.add(first)

    def add(self, frame: Frame) -> None:
        """Add a frame.

        Raises
        ------
        DataError
            If it holds no finite counts, or was taken by another camera or with other settings.
        """
        check_alike(frame, self.first, self.role)
        half = sum(self.counts) % 2
        self.sums[half] += frame.counts
        self.counts[half] += 1
        clipped = frame.counts >= saturation_count(frame)
        self.levels.append(self._level(frame, clipped))
        self.clipped |= clipped

    @property
    def count(self) -> int:
        """Number of frames."""
        return sum(self.counts)

    @property
    def mean(self) -> Tensor:
        """Their mean, in counts, black level included."""
        return (self.sums[0] + self.sums[1]) / self.count

    @property
    def white(self) -> float:
        """Count from which a pixel is saturated; infinite where that is not known."""
        return saturation_count(self.first)

    @property
    def uneven(self) -> float:
        """Largest difference of a frame's brightness from the first one's, as a fraction."""
        return max(abs(level - 1) for level in self.levels)

    @property
    def alike(self) -> bool:
        """Whether all frames are as bright as those of one exposure are."""
        return self.uneven <= _ALIKE

    def half_difference(self) -> Tensor | None:
        """Difference of the means of both halves, times what gives it the noise of one frame.

        None where there is only one frame.
        """
        if self.counts[1] == 0:
            return None
        one, other = (total / count for total, count in zip(self.sums, self.counts, strict=True))
        difference: Tensor = one - other
        return difference / math.sqrt(1 / self.counts[0] + 1 / self.counts[1])

    def half(self, number: int) -> tuple[Tensor, int]:
        """Mean of every second frame, from the first or the second one on, and their count."""
        return self.sums[number] / self.counts[number], self.counts[number]

    def _level(self, frame: Frame, clipped: Tensor) -> float:
        """Brightness beside that of the first frame, where neither is clipped."""
        black = black_plane(self.first)
        one, other = self.first.counts - black, frame.counts - black
        used = ~clipped & ~self.clipped
        total = float(one[used].square().sum())
        return float((one[used] * other[used]).sum()) / total if total > 0 else 1.0


class PointFrames:
    """Frames of a point source, and dark frames, averaged by exposure time as they come.

    Parameters
    ----------
    sensor
        Says the mosaic and the black and white level of frames whose files do not.

    Attributes
    ----------
    means
        Of the frames, by exposure time in s.
    timed
        Whether the exposure times are known.
    """

    def __init__(self, sensor: Sensor | None = None) -> None:
        self.means: dict[float, FrameMean] = {}
        self._sensor = sensor
        self.timed = False
        self._darks: dict[float, FrameMean] = {}

    def add(self, frame: Frame, exposure_s: float | None = None) -> None:
        """Add a frame; an exposure time counts more than that of its file.

        Raises
        ------
        DataError
            If it was taken by another camera or with other settings, or only one of it and the
            others has an exposure time.
        """
        frame = _completed(frame, self._sensor)
        time = frame.exposure_s if exposure_s is None else exposure_s
        if not self.means:
            self.timed = time is not None
        elif self.timed != (time is not None):
            raise DataError(
                f"{frame.source} says {'no' if self.timed else 'its'} exposure time, but "
                f"{self.first.source} does {'so' if self.timed else 'not'}: give the time of every "
                "frame (--exposure, once for each in their order)"
            )
        else:
            check_alike(frame, self.first)
        _add(self.means, frame, time, "frame")

    def add_dark(self, frame: Frame) -> None:
        """Add a frame without the point source, after the others.

        Raises
        ------
        DataError
            If it was taken by another camera or with other settings.
        """
        frame = _completed(frame, self._sensor)
        check_alike(frame, self.first, "dark frame")
        _add(self._darks, frame, frame.exposure_s or None, "dark frame")

    @property
    def first(self) -> Frame:
        """The first frame."""
        return next(iter(self.means.values())).first

    @property
    def channels(self) -> tuple[str, ...]:
        """Of the PSF."""
        return self.first.channels if self.first.mosaic is None else ("R", "G", "B")

    def darks(self) -> dict[float, FrameMean]:
        """The dark frames of each exposure time; those of a single time serve all.

        Raises
        ------
        DataError
            If there are dark frames of several times, and it is not clear which belong to one.
        """
        if not self.timed and len(self._darks) > 1:
            raise DataError(
                "the dark frames have several exposure times, and those of the frames are not "
                "known: give them (--exposure), or dark frames of the same time only"
            )
        matched: dict[float, FrameMean] = {}
        for time in self.means if self._darks else ():
            same = [each for each in self._darks if math.isclose(each, time, rel_tol=_SAME_TIME)]
            if not same and len(self._darks) > 1:
                have = ", ".join(f"{1e3 * each:g} ms" for each in sorted(self._darks))
                raise DataError(
                    f"there is no dark frame of {1e3 * time:g} ms, only of {have}: take one of "
                    "every exposure time, or give those of one time, for all"
                )
            matched[time] = self._darks[same[0] if same else next(iter(self._darks))]
        return matched

    def figures(self, ratios: Sequence[float]) -> dict[str, Any]:
        """Figures in values that JSON has; `ratios` are those of `Merged`."""
        darks = self.darks()
        return {
            "frames": sum(mean.count for mean in self.means.values()),
            "exposures": [
                {
                    "ms": round(1e3 * time, 6) if self.timed else None,
                    "frames": mean.count,
                    "dark_frames": darks[time].count if time in darks else 0,
                    "clipped_fraction": float(mean.clipped.double().mean()),
                    "brightness": round(ratio, 6),
                }
                for (time, mean), ratio in zip(sorted(self.means.items()), ratios, strict=True)
            ],
            "unit": "counts per second" if self.timed else "counts of one frame",
        }

    def warnings(self) -> list[str]:
        """What a person should know of the frames.

        Raises
        ------
        DataError
            If frames without exposure times are of several.
        """
        mean = next(iter(self.means.values()))
        if not self.timed and not mean.alike:
            raise DataError(
                f"the frames do not say their exposure times, and differ by {100 * mean.uneven:.3g}"
                f" % in brightness from {mean.first.source}: give the times (--exposure, once for "
                "each frame in their order), or frames of one exposure"
            )
        texts = [
            f"frames of {1e3 * time:g} ms differ by {100 * mean.uneven:.2g} % in brightness: a "
            "light that flickers, or settings that changed between them"
            for time, mean in self.means.items()
            if not mean.alike
        ]
        if not self._darks and not self.first.black_stated:
            texts.append(
                f"{self.first.source} does not say which count is black, and "
                f"{self.first.black[0]:g} is taken: give dark frames (--dark), or a camera "
                "(--camera)"
            )
        if not math.isfinite(min(mean.white for mean in self.means.values())):
            texts.append(
                f"{self.first.source} does not say from which count a pixel is saturated: make "
                "sure that none is"
            )
        for time, dark in self.darks().items():
            own = dark.first.exposure_s
            same = own is not None and math.isclose(own, time, rel_tol=_SAME_TIME)
            if self.timed and not same and own is not None:
                texts.append(
                    f"dark frames of {1e3 * own:g} ms are taken for frames of {1e3 * time:g} ms: "
                    "where the sensor's dark current counts, take dark frames of every exposure "
                    "time"
                )
        return texts


def _completed(frame: Frame, sensor: Sensor | None) -> Frame:
    """The frame with what the sensor says where its file does not."""
    if sensor is None:
        return frame
    whole = frame.size == (sensor.rows, sensor.columns)
    if frame.channels == ("grey",) and sensor.mosaic != "none" and whole:
        frame = replace(frame, channels=("mosaic",), mosaic=sensor.mosaic)
    if not frame.black_stated and len(frame.channels) == 1:
        white = min(sensor.saturated_counts, math.inf if frame.white is None else frame.white)
        frame = replace(frame, black=(sensor.black_counts,), white=white, black_stated=True)
    return frame


def _add(means: dict[float, FrameMean], frame: Frame, time_s: float | None, role: str) -> None:
    """Add a frame to the mean of those of its exposure time."""
    time = _UNKNOWN_S if time_s is None else time_s
    near = [each for each in means if math.isclose(each, time, rel_tol=_SAME_TIME)]
    if near:
        means[near[0]].add(frame)
    else:
        means[time] = FrameMean(frame, role)


def check_alike(frame: Frame, first: Frame, role: str = "frame") -> None:
    """Refuse a frame that was not taken by the camera, or with the settings, of another one.

    Raises
    ------
    DataError
        If its size, colours, black or white level are others, or it holds NaN or infinity.
    """
    reason = unusable(frame.counts)
    if reason is not None:
        raise DataError(f"{frame.source} holds {reason}")
    for (setting, text), (first_setting, first_text) in zip(
        _settings(frame), _settings(first), strict=True
    ):
        if setting != first_setting:
            raise DataError(
                f"the {role} {frame.source} has {text}, but {first.source} has {first_text}: give "
                "frames of one camera, taken with one setting of it"
            )


def _settings(frame: Frame) -> list[tuple[object, str]]:
    """What all frames of one camera and setting have in common, each with its text."""
    black = ", ".join(f"{level:g}" for level in frame.black)
    return [
        (
            (frame.counts.shape, frame.channels),
            f"{frame.size_text} pixels ({', '.join(frame.channels)})",
        ),
        (frame.mosaic, f"the colour mosaic {frame.mosaic}"),
        ((frame.black, frame.white), f"black {black} and white {frame.white}"),
    ]


def black_plane(frame: Frame) -> Tensor:
    """Black level of a frame, of a shape that broadcasts with its counts."""
    levels = torch.tensor(frame.black)
    if len(levels) == 1:
        return levels.reshape(1, 1, 1)
    if frame.mosaic in MOSAICS:
        rows, columns = frame.counts.shape[-2:]
        return levels.reshape(2, 2).repeat(-(-rows // 2), -(-columns // 2))[:rows, :columns][None]
    return levels[:, None, None]
