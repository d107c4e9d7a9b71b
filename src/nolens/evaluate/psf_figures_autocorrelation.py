"""Width and pitch of a pattern from its autocorrelation, between the cells."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.evaluate.psf_figures_spectrum import column_weights
from nolens.kernels import fast_length, rfft2

_STEP = 0.25
"""Cells from one value of a profile to the next."""
_BINS = 8192
_FARTHEST = math.sqrt(0.5)
"""Cycles to the cell, of the corners of the spectrum."""
_STRIP = 16
_LEAST_RISE = 0.01
"""Of a second peak, over the lowest value before it: less is chance."""


@dataclass(frozen=True)
class Autocorrelation:
    """Autocorrelation of a pattern without its mean and without white noise; 1 at zero.

    Parameters
    ----------
    lag
        Distances in cells.
    radial
        Mean over all directions.
    row
        Along the rows, in both directions the same.
    """

    lag: Tensor
    radial: Tensor
    row: Tensor

    @classmethod
    def of(cls, pattern: Tensor, background: float, noise: float) -> "Autocorrelation":
        r"""Work it out up to a quarter of the frame, every quarter of a cell.

        .. math:: A(r) = \sum_f P_f\,J_0(2π f r), \qquad A_0(x) = \sum_f P_f \cos(2π f_x x)

        are the band-limited autocorrelation's mean over a circle and its values on a line, without
        rounding to cells. The frame, without its edge (`trimmed`), stands in zeros: what leaves it
        does not come in again. Of both, what even light of the same mean would have is taken off.

        Parameters
        ----------
        pattern
            (rows, columns).
        background
            What lies evenly under it.
        noise
            Standard deviation of white noise in it.
        """
        light = trimmed(pattern.double() - background)
        rows, columns = light.shape
        cells, reach = rows * columns, min(rows, columns) // 4
        padded = (
            fast_length(rows + reach, of_rows=False),
            fast_length(columns + reach, of_rows=True),
        )
        values = torch.zeros(padded, dtype=torch.float64)
        values[:rows, :columns] = light
        mean = float(values.sum()) / cells
        power = rfft2(values).abs().square() - noise**2 * cells
        power = power * column_weights(padded[1]) / (cells * padded[0] * padded[1])
        down = torch.fft.fftfreq(padded[0], dtype=torch.float64)
        right = torch.fft.rfftfreq(padded[1], dtype=torch.float64)
        lag = torch.arange(0, reach + _STEP, _STEP, dtype=torch.float64)
        place = (torch.hypot(down[:, None], right) / _FARTHEST * _BINS).flatten()
        lower = place.long()
        share = place - lower
        binned = torch.zeros(_BINS + 2, dtype=torch.float64)
        for bins, part in ((lower, 1 - share), (lower + 1, share)):
            binned.index_add_(0, bins, power.flatten() * part)
        at = torch.arange(_BINS + 2, dtype=torch.float64) * (_FARTHEST / _BINS)
        radial = torch.special.bessel_j0(2 * math.pi * lag[:, None] * at) @ binned
        row = torch.cos(2 * math.pi * lag[:, None] * right) @ power.sum(dim=0)
        # Of the frame, this much still lies over itself: (1 - |x|/columns) (1 - |y|/rows).
        over = 1 - 2 * lag / math.pi * (1 / rows + 1 / columns) + lag**2 / (math.pi * cells)
        radial, row = radial - mean**2 * over, row - mean**2 * (1 - lag / columns)
        return cls(lag, radial / radial[0], row / row[0])

    def level(self) -> float:
        """Lowest value between the first peak, at zero, and the second.

        Where spots do not touch, that is what chance and the mean that was taken off leave between
        them, and the first peak above it has the shape of one spot's own autocorrelation.
        """
        return float(self.radial[_valley(self.radial)])

    def width(self, profile: Tensor, level: float) -> float | None:
        """Full width of the first peak half way between 1 and a level, in cells."""
        half = (1 + level) / 2
        below = (profile < half).nonzero()
        if len(below) == 0:
            return None
        first = int(below[0])
        before, after = float(profile[first - 1]), float(profile[first])
        return 2 * _STEP * (first - 1 + (before - half) / (before - after))

    def pitch(self, profile: Tensor, level: float, *, spread: bool) -> float | None:
        r"""Distance of the second peak in cells; None without one that rises by 1 %.

        Farther neighbours can make a higher peak: the first one of at least half the height
        counts.

        Parameters
        ----------
        profile
            `radial` or `row`.
        level
            What the peaks stand on.
        spread
            The neighbours' peak is spread over a circle of radius r, on which it fades as
            :math:`1/\sqrt r`: that is made up for, so that it does not seem nearer.
        """
        above = profile - level
        valley = _valley(profile)
        rest = above[valley:]
        high = rest >= (rest.min() + rest.max()) / 2
        start = int(high.nonzero()[0])
        ends = (~high[start:]).nonzero()
        length = int(ends[0]) if len(ends) else len(rest) - start
        peak = valley + start + int(rest[start : start + length].argmax())
        rise = float(above[peak] - above[valley])
        if not valley < peak < len(above) - 1 or rise < _LEAST_RISE:
            return None
        if spread:
            above = above * self.lag.sqrt()
            while above[peak + 1] > above[peak] and peak < len(above) - 2:
                peak += 1
        left, top, right = (float(above[peak + step]) for step in (-1, 0, 1))
        return _STEP * (peak + (left - right) / (2 * (left - 2 * top + right)))


def trimmed(light: Tensor) -> Tensor:
    """Leave out up to a sixteenth of the frame on every side, so that it ends where it is dark.

    Spots that the frame's edge cuts through would count as narrower ones.
    """
    for axis in (0, 1):
        lines = light.square().sum(dim=1 - axis)
        strip = max(1, len(lines) // _STRIP)
        first = int(lines[:strip].argmin())
        last = len(lines) - 1 - int(lines.flip(0)[:strip].argmin())
        light = light.narrow(axis, first, last + 1 - first)
    return light


def _valley(profile: Tensor) -> int:
    """The first place below a half after which the profile rises; its end if it does not."""
    below = (profile < 0.5).nonzero()
    start = int(below[0]) if len(below) else 0
    rising = (profile[start + 1 :] > profile[start:-1]).nonzero()
    return start + int(rising[0]) if len(rising) else len(profile) - 1
