"""How bright a frame is, the exposure time that would fit, and the mean of some frames."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.calibrate.frames import check_alike
from nolens.camera import Frame
from nolens.camera.measurement import colour_planes
from nolens.capture.source import CameraSource, Limits, Shot

_BINS = 64
"""Of a histogram."""
_FINE = 16
"""Steps in a bin, for what is read off the histogram."""
_BRIGHT = 0.999
_FASTEST = 8.0
"""Factor on the exposure time in one step."""
_FILL = 0.8
"""Fraction of the range that the light is to fill."""
_FITS = 0.1
_FIRST_S = 0.01
_TRIES = 12
_DIGITS = 2


@dataclass(frozen=True)
class Levels:
    """How a frame fills the range of its counts, from no light (0) to saturated (1).

    Attributes
    ----------
    histogram
        Pixels of every colour in each of 64 steps from black to saturation.
    clipped_fraction
        Fraction of all pixels that are saturated.
    bright
        What 99.9 % of the pixels do not exceed.
    brightest
        Of the brightest pixel.
    mean
        Of all pixels.
    """

    histogram: dict[str, tuple[int, ...]]
    clipped_fraction: float
    bright: float
    brightest: float
    mean: float

    @classmethod
    def of(cls, frame: Frame) -> "Levels":
        """Levels of a frame; where it does not say what is saturated, its brightest pixel is 1."""
        counts = frame.counts
        black = sum(frame.black) / len(frame.black)
        highest = float(counts.max())
        white = max(highest if frame.white is None else frame.white, black + 1e-6)
        if frame.mosaic is None:
            colours = {name: [plane] for name, plane in zip(frame.channels, counts, strict=True)}
        else:
            colours = colour_planes(counts[0], frame.mosaic)
        fine = {name: _histogram(parts, black, white) for name, parts in colours.items()}
        below = torch.stack(list(fine.values())).sum(dim=0).cumsum(0)
        step = int(torch.searchsorted(below, _BRIGHT * counts.numel()))
        clipped = 0 if frame.white is None else int((counts >= frame.white).sum())
        mean = float(counts.mean(dtype=torch.float64))
        return cls(
            {
                name: tuple(each.reshape(_BINS, _FINE).sum(dim=1).long().tolist())
                for name, each in fine.items()
            },
            clipped / counts.numel(),
            min(step + 1, len(below)) / len(below),
            (highest - black) / (white - black),
            (mean - black) / (white - black),
        )


def exposure_for(
    levels: Levels,
    exposure_s: float,
    limits: Limits,
    *,
    every_pixel: bool = False,
) -> float:
    """Exposure time that fills the range better than that of a frame did.

    Parameters
    ----------
    levels
        Of the frame.
    exposure_s
        Of the frame.
    limits
        What the camera can be set to.
    every_pixel
        Whether no pixel may be brighter, as suits a PSF, whose bright points count; otherwise one
        in a thousand may.

    Returns
    -------
    float
        At most eight times shorter or longer than it was; the same where it fits.
    """
    level = levels.brightest if every_pixel else levels.bright
    saturated = level >= 1
    factor = 1 / _FASTEST if saturated else min(_FILL / max(level, 1e-9), _FASTEST)
    if abs(factor - 1) <= _FITS:
        factor = 1.0
    shortest, longest = limits.exposure_s
    return min(max(exposure_s * factor, shortest), longest)


def fitting_exposure(
    source: CameraSource,
    limits: Limits,
    gain: float,
    *,
    every_pixel: bool = False,
    progress: Callable[[float], None] | None = None,
) -> float:
    """Exposure time that fits what a camera sees now, by `exposure_for` from frame to frame.

    Parameters
    ----------
    source
        The open camera; the last frame was taken with nearly this time.
    limits
        Between which the time is sought.
    gain
        Of all frames.
    every_pixel
        As `exposure_for` takes it.
    progress
        Called with the fraction of the tries that are done.

    Returns
    -------
    float
        In s, with two digits.

    Raises
    ------
    CameraError
        If the camera gives no frames.
    """
    shortest, longest = limits.exposure_s
    exposure_s = min(max(_FIRST_S, shortest), longest)
    for number in range(_TRIES):
        if progress is not None:
            progress(number / _TRIES)
        source.set(exposure_s=exposure_s, gain=gain)
        levels = Levels.of(source.shot().frame)
        better_s = exposure_for(levels, exposure_s, limits, every_pixel=every_pixel)
        if better_s == exposure_s:
            break
        exposure_s = better_s
    if progress is not None:
        progress(1.0)
    digits = _DIGITS - 1 - math.floor(math.log10(exposure_s))
    return min(max(round(exposure_s, digits), shortest), longest)


class Burst:
    """The mean of frames of one exposure, which are added as they come."""

    def __init__(self) -> None:
        self.frames = 0
        self._first: Shot | None = None
        self._sum = torch.empty(0)
        self._clipped = torch.empty(0, dtype=torch.bool)

    def add(self, shot: Shot) -> None:
        """Add a frame.

        Raises
        ------
        DataError
            If it does not have the size, colours and levels of the first one.
        """
        counts = shot.frame.counts
        if self._first is None:
            self._first = shot
            self._sum = torch.zeros_like(counts, dtype=torch.float64)
            self._clipped = torch.zeros_like(counts, dtype=torch.bool)
        check_alike(shot.frame, self._first.frame)
        self._sum += counts
        if shot.frame.white is not None:
            self._clipped |= counts >= shot.frame.white
        self.frames += 1

    def mean(self) -> Shot:
        """Their mean; a pixel that is saturated in one of them is so in the mean."""
        assert self._first is not None
        counts = (self._sum / self.frames).float()
        if self._first.frame.white is not None:
            counts[self._clipped] = self._first.frame.white
        return replace(self._first, frame=replace(self._first.frame, counts=counts))


def _histogram(parts: list[Tensor], black: float, white: float) -> Tensor:
    """Pixels in fine steps; what lies beyond the range counts as its end."""
    count = _BINS * _FINE
    # Whole numbers are counted three times as fast as `histc` sorts floats.
    steps = [(part - black).mul_(count / (white - black)).clamp_(0, count - 1) for part in parts]
    counts = [torch.bincount(each.int().flatten(), minlength=count) for each in steps]
    return torch.stack(counts).sum(dim=0).double()
