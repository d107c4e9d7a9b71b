"""How bright a frame is: its histogram, what clips, and the exposure time that would fit."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.camera import Frame
from nolens.camera.measurement import colour_planes
from nolens.capture.source import Limits

BINS = 64
"""Of a histogram."""
_FINE = 16
"""Steps in a bin, for what is read off the histogram."""
_BRIGHT = 0.999
_FASTEST = 8.0
"""Factor on the exposure time in one step."""
_FITS = 0.1


@dataclass(frozen=True)
class Levels:
    """How a frame fills the range of its counts, from no light (0) to saturated (1).

    Attributes
    ----------
    histogram
        Pixels of every colour in each of `BINS` steps from black to saturation.
    clipped_share
        Fraction of all pixels that are saturated.
    bright
        What 99.9 % of the pixels do not exceed.
    brightest
        Of the brightest pixel.
    mean
        Of all pixels.
    """

    histogram: dict[str, tuple[int, ...]]
    clipped_share: float
    bright: float
    brightest: float
    mean: float

    @classmethod
    def of(cls, frame: Frame) -> "Levels":
        """Look at a frame; where it does not say what is saturated, its brightest pixel is 1."""
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
                name: tuple(each.reshape(BINS, _FINE).sum(dim=1).long().tolist())
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
    fill: float = 0.8,
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
    fill
        Fraction of the range that is wanted.
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
    factor = 1 / _FASTEST if saturated else min(fill / max(level, 1e-9), _FASTEST)
    if abs(factor - 1) <= _FITS:
        factor = 1.0
    shortest, longest = limits.exposure_s
    return min(max(exposure_s * factor, shortest), longest)


def _histogram(parts: list[Tensor], black: float, white: float) -> Tensor:
    """Pixels in fine steps; what lies beyond the range counts as its end."""
    count = BINS * _FINE
    # Whole numbers are counted three times as fast as `histc` sorts floats.
    steps = [(part - black).mul_(count / (white - black)).clamp_(0, count - 1) for part in parts]
    counted = [torch.bincount(each.int().flatten(), minlength=count) for each in steps]
    return torch.stack(counted).sum(dim=0).double()
