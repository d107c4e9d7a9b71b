"""Figures of a surface: its heights, its slopes and how its tops are curved."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from nolens.optics.relief import Relief

_SIDE = 2048
"""Points along a side of the middle part that the tops are looked for in."""


@dataclass(frozen=True)
class ReliefFigures:
    """What a surface is like.

    Parameters
    ----------
    size_um
        Height and width.
    rms_um
        Standard deviation of the heights.
    peak_to_valley_um
        From the lowest point to the highest.
    steepest
        Largest slope between neighbouring points.
    correlation_um
        Distance at which the autocorrelation of the heights has fallen to a half; 0 for a flat
        surface.
    tops
        Local maxima within the middle part, at most 2048 points wide.
    radius_um
        Radius of curvature of the tops, the median of them; None without tops.
    """

    size_um: tuple[float, float]
    rms_um: float
    peak_to_valley_um: float
    steepest: float
    correlation_um: float
    tops: int
    radius_um: float | None


def relief_figures(relief: Relief) -> ReliefFigures:
    r"""Measure a surface.

    A top is a point above all others within the correlation length. A paraboloid
    :math:`a+bx+cy+\tfrac12(dx^2+2exy+fy^2)` is fitted within a quarter of that length around
    it, along rows and columns; its radius is :math:`-2/(d+f)`, that of the mean curvature.
    """
    heights = relief.height_um.numpy().astype(np.float64)
    middle = heights[tuple(_middle(count) for count in heights.shape)]
    lag = _correlation(middle)
    curvatures = _top_curvatures(middle, lag) / relief.grid_um**2 if lag > 0 else np.zeros(0)
    return ReliefFigures(
        size_um=relief.extent_um,
        rms_um=float(heights.std()),
        peak_to_valley_um=float(np.ptp(heights)),
        steepest=relief.steepest,
        correlation_um=lag * relief.grid_um,
        tops=len(curvatures),
        radius_um=float(1 / np.median(curvatures)) if len(curvatures) else None,
    )


def _middle(count: int) -> slice:
    first = max(0, (count - _SIDE) // 2)
    return slice(first, first + min(count, _SIDE))


def _correlation(heights: NDArray[np.float64]) -> float:
    """Lag in points at which the autocorrelation along the rows and columns is a half."""
    lags = []
    for axis in (0, 1):
        count = heights.shape[axis]
        even = heights - heights.mean()
        power = np.abs(np.fft.rfft(even, 2 * count, axis=axis)) ** 2
        curve = np.fft.irfft(power.sum(axis=1 - axis))[:count]
        curve /= np.arange(count, 0, -1)
        below = np.flatnonzero(curve <= curve[0] / 2)
        if not curve[0] > 0 or len(below) == 0:
            return 0.0
        after = int(below[0])
        share = (curve[after - 1] - curve[0] / 2) / (curve[after - 1] - curve[after])
        lags.append(after - 1 + float(share))
    return sum(lags) / 2


def _top_curvatures(heights: NDArray[np.float64], lag: float) -> NDArray[np.float64]:
    """Mean curvature of every top, above 0, per point."""
    apart, half = max(1, round(lag)), max(2, round(lag / 4))
    highest = heights == maximum_filter(heights, 2 * apart + 1)
    highest[:half], highest[-half:], highest[:, :half], highest[:, -half:] = (False,) * 4
    rows, columns = np.nonzero(highest)
    down, right = np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)
    basis = np.stack([np.ones(down.shape), down, right, down**2 / 2, down * right, right**2 / 2])
    around = heights[rows[:, None] + down, columns[:, None] + right]
    factors = np.linalg.lstsq(basis.T, around.T, rcond=None)[0]
    curvatures = -(factors[3] + factors[5]) / 2
    above: NDArray[np.float64] = curvatures[curvatures > 0]
    return above
