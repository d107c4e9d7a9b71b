"""Measured surfaces: gaps, tilt, other grids, continuation beyond the edges, and their figures."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d, maximum_filter
from scipy.sparse import coo_matrix
from scipy.sparse.linalg import spsolve

from nolens.optics.mask import Relief

Heights = NDArray[np.float64]

_ANTIALIAS = 0.4
"""Standard deviation of the Gaussian before a coarser grid, in its steps."""
_SIDE = 2048
"""Points along a side of the middle part that the tops are looked for in."""


@dataclass(frozen=True)
class Tilt:
    """How a surface lies and bends as a whole.

    Parameters
    ----------
    rise_mrad
        Slope of the best-fit plane in mrad, downwards along the columns' direction (rows) and to
        the right (columns).
    bow_um
        Height of the middle above the corners, of the best-fit paraboloid of revolution, in um.
    """

    rise_mrad: tuple[float, float]
    bow_um: float


def oriented(
    heights_um: Heights,
    pitch_um: tuple[float, float],
    *,
    mirror: bool = False,
    invert: bool = False,
    turn_deg: int = 0,
) -> tuple[Heights, tuple[float, float]]:
    """Heights and the distances of their rows and columns, as the part lies on the camera.

    `mirror` exchanges top and bottom, `invert` takes heights for depths, and the map is turned by
    0, 90, 180 or 270 degrees anticlockwise, after the exchange.
    """
    if invert:
        heights_um = -heights_um
    if mirror:
        heights_um = heights_um[::-1]
    if turn_deg in (90, 270):
        pitch_um = (pitch_um[1], pitch_um[0])
    return np.rot90(heights_um, turn_deg // 90), pitch_um


def fill_gaps(heights_um: Heights) -> Heights:
    r"""Heights with their gaps closed, each point there being the mean of its neighbours.

    That is Laplace's equation :math:`\sum_{j\sim i}(h_i-h_j)=0` on the points of the gaps, with
    the measured points around them as they are. Gaps are NaN; at least one point is finite.
    """
    missing = np.isnan(heights_um)
    count = int(missing.sum())
    if count == 0:
        return heights_um
    number = np.full(heights_um.shape, -1)
    number[missing] = np.arange(count)
    diagonal, constant = np.zeros(count), np.zeros(count)
    at: list[NDArray[np.int64]] = []
    beside: list[NDArray[np.int64]] = []
    for axis in (0, 1):
        for here, there in ((slice(1, None), slice(None, -1)), (slice(None, -1), slice(1, None))):
            one = (here, slice(None)) if axis == 0 else (slice(None), here)
            other = (there, slice(None)) if axis == 0 else (slice(None), there)
            gap = missing[one]
            numbers, neighbours = number[one][gap], number[other][gap]
            values = heights_um[other][gap]
            np.add.at(diagonal, numbers, 1.0)
            known = neighbours < 0
            np.add.at(constant, numbers[known], values[known])
            at.append(numbers[~known])
            beside.append(neighbours[~known])
    rows = np.concatenate([*at, np.arange(count)])
    columns = np.concatenate([*beside, np.arange(count)])
    weights = np.concatenate([np.full(len(rows) - count, -1.0), diagonal])
    matrix = coo_matrix((weights, (rows, columns)), shape=(count, count)).tocsr()
    closed = heights_um.copy()
    closed[missing] = spsolve(matrix, constant)
    return closed


def remove_tilt(heights_um: Heights, pitch_um: tuple[float, float]) -> tuple[Heights, Tilt]:
    """Heights over their best-fit plane, and how that and the best-fit paraboloid lie.

    Points that were not measured are NaN. The pitch is that of the rows and of the columns.
    """
    places = [
        (np.arange(count) - (count - 1) / 2) * step
        for count, step in zip(heights_um.shape, pitch_um, strict=True)
    ]
    known = ~np.isnan(heights_um)
    down, right = np.broadcast_arrays(places[0][:, None], places[1])
    radius = math.hypot(*(float(np.abs(each).max()) for each in places)) or 1.0
    plane = np.stack([np.ones(int(known.sum())), down[known] / radius, right[known] / radius])
    factors = _fit(plane, heights_um[known])
    flat = heights_um - factors[0] - (factors[1] * down + factors[2] * right) / radius
    bowl = np.vstack([plane, plane[1] ** 2 + plane[2] ** 2])
    curved = _fit(bowl, heights_um[known])
    slopes = (1e3 * float(factors[1]) / radius, 1e3 * float(factors[2]) / radius)
    return flat, Tilt(slopes, -float(curved[3]))


def resample(heights_um: Heights, pitch_um: tuple[float, float], grid_um: float) -> Heights:
    """Heights on a square grid with the same middle, within the area that was measured.

    Cubic splines go through all points, finite and at least 4×4; before a coarser grid a Gaussian
    takes away what it cannot hold. The pitch is that of the rows and of the columns, `grid_um`
    the distance of the result's points.
    """
    for axis, step in enumerate(pitch_um):
        count = heights_um.shape[axis]
        places = (np.arange(count) - (count - 1) / 2) * step
        # A rounding error must not cost the last point.
        points = math.floor((count - 1) * step / grid_um + 1e-9) + 1
        at = (np.arange(points) - (points - 1) / 2) * grid_um
        if np.array_equal(places, at):
            continue
        if grid_um > step:
            heights_um = gaussian_filter1d(
                heights_um, _ANTIALIAS * grid_um / step, axis, mode="nearest"
            )
        at = at.clip(places[0], places[-1])
        heights_um = make_interp_spline(places, heights_um, k=3, axis=axis)(at)
    return heights_um


def extend_by_reflection(heights_um: Heights, size: tuple[int, int]) -> Heights:
    """Heights continued to a larger size by reflection at the edges, again and again.

    Where there are as many rows or columns as in `size` already, they stay.
    """
    lacking = [max(0, target - count) for target, count in zip(size, heights_um.shape, strict=True)]
    return np.pad(heights_um, [(each // 2, each - each // 2) for each in lacking], mode="reflect")


def _fit(basis: Heights, values: Heights) -> Heights:
    """Least squares by the normal equations: the basis is of size 1."""
    return np.asarray(np.linalg.lstsq(basis @ basis.T, basis @ values)[0], np.float64)


@dataclass(frozen=True)
class _ReliefFigures:
    """What a surface is like: standard deviation of its heights, largest slope, number of tops.

    Tops are local maxima within the middle part, at most 2048 points wide; their radius of
    curvature is the median, None without tops. At `correlation_um` the autocorrelation of the
    heights has fallen to a half; 0 for a flat surface.
    """

    size_um: tuple[float, float]
    rms_um: float
    peak_to_valley_um: float
    steepest: float
    correlation_um: float
    tops: int
    radius_um: float | None


def relief_figures(relief: Relief) -> _ReliefFigures:
    r"""Measure a surface.

    A top is a point above all others within the correlation length. A paraboloid
    :math:`a+bx+cy+\tfrac12(dx^2+2exy+fy^2)` is fitted within a quarter of that length around
    it, along rows and columns; its radius is :math:`-2/(d+f)`, that of the mean curvature.
    """
    heights = relief.height_um.numpy().astype(np.float64)
    middle = heights[tuple(_middle(count) for count in heights.shape)]
    lag = _correlation(middle)
    curvatures = _top_curvatures(middle, lag) / relief.grid_um**2 if lag > 0 else np.zeros(0)
    return _ReliefFigures(
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
        fraction = (curve[after - 1] - curve[0] / 2) / (curve[after - 1] - curve[after])
        lags.append(after - 1 + float(fraction))
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
