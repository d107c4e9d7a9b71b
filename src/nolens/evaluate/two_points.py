"""Two point sources in a picture: how deep the dip between them is, and what is resolved."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from nolens.errors import DataError

RAYLEIGH_DIP = 0.265
"""Dip of the light between two equal points that the Rayleigh criterion asks for."""

_STEP = 0.05
_EQUAL = 0.3
_DARK = 0.2
_Array = NDArray[np.float64]
_Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class PointPair:
    """What a picture shows of two points.

    Parameters
    ----------
    dip
        :math:`1 - I_v / I_p` of the valley between the peaks and the fainter of them; 0 where
        there is one peak only.
    separation
        Distance of the peaks in pixels; 0 where there is one only.
    direction_deg
        Of the line through them, from the right towards up.
    at
        Places along that line in pixels, 0 midway between the ends of the trace.
    trace
        Light at these places, 1 at the brighter peak.
    """

    dip: float
    separation: float
    direction_deg: float
    at: Tensor
    trace: Tensor


@dataclass(frozen=True)
class ResolvedSeparation:
    """The smallest separation that is resolved.

    Parameters
    ----------
    value
        Interpolated between the largest unresolved separation and the next one; None where all
        are resolved, or the largest is not.
    plus_minus
        Half the way between those two, and the noise of their dips, added as squares.
    unresolved, resolved
        Those two; None where there is none.
    """

    value: float | None
    plus_minus: float | None
    unresolved: float | None
    resolved: float | None


def point_pair(picture: Tensor, separation: float) -> PointPair:
    r"""Measure the dip between two point sources.

    The trace runs through the two brightest maxima that are as far apart as they should be, or,
    where there is only one, along the longer axis of its light (second moments). It is read off a
    spline of order 5. Where two images of a round opening just meet Rayleigh's criterion
    (`rayleigh1879`), the dip is 26.5 %.

    Parameters
    ----------
    picture
        (height, width), linear, in any unit.
    separation
        Distance of the points in pixels, as it should be. Peaks count that are nearer to it than
        35 % or 1.5 pixels.

    Raises
    ------
    DataError
        If the picture is dark or not finite, bright beside the points, or shows two points
        at another distance.
    """
    values = picture.double().cpu().numpy()
    if not np.isfinite(values).all() or not values.max() > 0:
        raise DataError("the picture is dark or not finite: it shows no two point sources")
    main = _brightest(values, np.isfinite(values))
    assert main is not None
    grid: _Array = np.indices(values.shape, dtype=np.float64)
    away = np.hypot(grid[0] - main[0], grid[1] - main[1])
    off = max(1.5, 0.35 * separation)
    maxima = values == ndimage.maximum_filter(values, size=3, mode="constant", cval=-np.inf)
    _check_only_two(values, away, maxima, separation + off)
    fitting = maxima & (values >= _EQUAL * values.max()) & (np.abs(away - separation) <= off)
    other = _brightest(values, fitting & (away >= 2))
    if other is None:
        near = np.where(away <= separation / 2 + 3, values, 0).clip(min=0)
        centre, unit = _longer_axis(near, grid)
    else:
        ends = [_finer(values, each) for each in (main, other)]
        centre = (ends[0] + ends[1]) / 2
        unit = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    if unit[1] < 0 or (unit[1] == 0 and unit[0] > 0):
        unit = -unit
    half = separation / 2 + off + 3
    at = np.arange(-math.ceil(half / _STEP), math.ceil(half / _STEP) + 1) * _STEP
    places = centre[:, None] + unit[:, None] * at
    trace = ndimage.map_coordinates(values, places, order=5, mode="constant")
    dip, apart = _dip(trace, separation, off)
    return PointPair(
        dip,
        apart,
        math.degrees(math.atan2(0.0 - unit[0], unit[1])),
        torch.from_numpy(at),
        torch.from_numpy(trace / trace.max()),
    )


def resolved_separation(
    separations: tuple[float, ...],
    dips: tuple[float, ...],
    noise: tuple[float, ...],
    *,
    threshold: float = RAYLEIGH_DIP,
) -> ResolvedSeparation:
    """Find from which separation on every dip is deep enough.

    Parameters
    ----------
    separations
        In any unit, each once, in any order.
    dips
        Of each.
    noise
        Standard error of each dip.
    threshold
        The dip that counts as resolved.
    """
    ordered = sorted(zip(separations, dips, noise, strict=True))
    unresolved = [number for number, (_, dip, _) in enumerate(ordered) if dip < threshold]
    if not unresolved:
        return ResolvedSeparation(None, None, None, ordered[0][0])
    last = unresolved[-1]
    if last == len(ordered) - 1:
        return ResolvedSeparation(None, None, ordered[last][0], None)
    (below, low, low_noise), (above, high, high_noise) = ordered[last : last + 2]
    part = (threshold - low) / (high - low)
    slope = (above - below) / (high - low)
    scatter = slope * math.hypot((1 - part) * low_noise, part * high_noise)
    return ResolvedSeparation(
        below + part * (above - below), math.hypot((above - below) / 2, scatter), below, above
    )


def _check_only_two(values: _Array, away: _Array, maxima: _Mask, extent: float) -> None:
    """Refuse a picture of something else than two points."""
    beside, peak = values[away > extent], values.max()
    if beside.size > 0 and beside.mean() > _DARK * peak:
        raise DataError(
            f"beside its brightest point the picture is {100 * beside.mean() / peak:.0f} % as "
            "bright on average: it shows no two point sources in the dark. Check the file, or "
            "cut it to the points (--support)"
        )
    far = _brightest(values, maxima & (away > extent) & (values > peak / 2))
    if far is not None:
        raise DataError(
            f"the picture shows point sources {away[far]:.1f} pixels apart, and two at most "
            f"{extent:.1f} pixels apart were expected: check the separation, the distance and the "
            "angle of a pixel, or cut it to the points (--support)"
        )


def _brightest(values: _Array, where: _Mask) -> tuple[int, int] | None:
    """Row and column of the brightest of some pixels."""
    if not where.any():
        return None
    row, column = divmod(int(np.where(where, values, -np.inf).argmax()), values.shape[1])
    return row, column


def _finer(values: _Array, pixel: tuple[int, int]) -> _Array:
    """Where the top of a maximum lies, by a parabola along rows and columns."""
    place = np.array(pixel, dtype=np.float64)
    for axis, line in enumerate((values[:, pixel[1]], values[pixel[0]])):
        at = pixel[axis]
        if 0 < at < len(line) - 1:
            before, top, after = line[at - 1 : at + 2]
            bend = before - 2 * top + after
            place[axis] += (before - after) / (2 * bend) if bend < 0 else 0.0
    return place


def _longer_axis(light: _Array, grid: _Array) -> tuple[_Array, _Array]:
    """Centre of mass, and unit vector along which the light extends farthest."""
    weight = light / light.sum()
    centre = (weight * grid).sum((1, 2))
    row, column = grid - centre[:, None, None]
    mixed = (weight * row * column).sum()
    moments = np.array([[(weight * row**2).sum(), mixed], [mixed, (weight * column**2).sum()]])
    return centre, np.linalg.eigh(moments)[1][:, -1]


def _dip(trace: _Array, separation: float, off: float) -> tuple[float, float]:
    """Dip between the highest peak and the highest other one at about the right distance."""
    inner = trace[1:-1]
    peaks = 1 + np.flatnonzero((inner >= trace[:-2]) & (inner > trace[2:]))
    if len(peaks) == 0:
        return 0.0, 0.0
    main = peaks[trace[peaks].argmax()]
    apart = np.abs(peaks - main) * _STEP
    fitting = (np.abs(apart - separation) <= off) & (trace[peaks] >= _EQUAL * trace[main])
    others = peaks[fitting & (peaks != main)]
    if len(others) == 0:
        return 0.0, 0.0
    other = others[trace[others].argmax()]
    between = trace[min(main, other) : max(main, other) + 1]
    return float(1 - max(between.min(), 0.0) / trace[other]), float(abs(other - main) * _STEP)


@dataclass(frozen=True)
class ObservedPair:
    """One picture of two points.

    Parameters
    ----------
    separation_deg
        Angle between them.
    pair
        What the picture shows.
    picture
        (height, width).
    """

    separation_deg: float
    pair: PointPair
    picture: Tensor


@dataclass(frozen=True)
class TwoPoints:
    """Resolution by two points at several separations.

    Parameters
    ----------
    separations_deg
        Each once, the smallest first.
    dips
        Mean of the pictures of each.
    noise
        Its standard error; 0 where there is one picture.
    resolved
        The smallest angle from which on the dips are deep enough, in degrees.
    threshold
        The dip that is deep enough.
    pairs
        One picture of each separation, the first that was taken.
    """

    separations_deg: tuple[float, ...]
    dips: tuple[float, ...]
    noise: tuple[float, ...]
    resolved: ResolvedSeparation
    threshold: float
    pairs: tuple[ObservedPair, ...]

    @property
    def figures(self) -> dict[str, Any]:
        """What is resolved, and the dips by separation, in values that JSON has."""
        return {
            "resolved_deg": self.resolved.value,
            "plus_minus_deg": self.resolved.plus_minus,
            "largest_unresolved_deg": self.resolved.unresolved,
            "smallest_resolved_deg": self.resolved.resolved,
            "dip_needed": self.threshold,
            "separations": [
                {
                    "separation_deg": angle,
                    "dip": dip,
                    "dip_noise": noise,
                    "resolved": dip >= self.threshold,
                }
                for angle, dip, noise in zip(
                    self.separations_deg, self.dips, self.noise, strict=True
                )
            ],
        }

    @classmethod
    def of(cls, pairs: Sequence[ObservedPair], threshold: float = RAYLEIGH_DIP) -> "TwoPoints":
        """Sort pictures by separation and find what is resolved."""
        angles = tuple(sorted({each.separation_deg for each in pairs}))
        groups = [[each for each in pairs if each.separation_deg == angle] for angle in angles]
        stacked = [torch.tensor([each.pair.dip for each in group]).double() for group in groups]
        dips = tuple(float(each.mean()) for each in stacked)
        noise = tuple(
            float(each.std()) / math.sqrt(len(each)) if len(each) > 1 else 0.0 for each in stacked
        )
        resolved = resolved_separation(angles, dips, noise, threshold=threshold)
        return cls(angles, dips, noise, resolved, threshold, tuple(group[0] for group in groups))
