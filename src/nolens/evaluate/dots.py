"""Dots in a picture: where each one is, and how good."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import scipy.ndimage
from numpy.typing import NDArray
from torch import Tensor

_FINER = 6
_BEYOND = 2
"""Values along a pixel when a dot is looked at, and pixels around it for their interpolation."""
_HALF = 0.5
_CLEAR = 0.38
_AROUND = 1.6
_LEAST_CLEAR = 12
_ROSE = 5.0
_FAINTEST = 1e-6
_FAINT = 0.25
"""Fraction of the brightest value from which on it is more than rounding."""
Grade = Literal["good", "distorted", "lost"]


@dataclass(frozen=True)
class Spot:
    """A dot as it is in a picture.

    Parameters
    ----------
    place
        Row and column of its middle.
    width
        Diameter of a circle with the area in which it is brighter than half its height, in pixels.
    light
        Sum over its part of the grid, above what lies between the dots.
    peak
        Height above that.
    """

    place: tuple[float, float]
    width: float
    light: float
    peak: float


def spots_at(
    picture: Tensor, places: Sequence[tuple[float, float]], spacings: Sequence[float]
) -> list[Spot | None]:
    """Look for a dot near each of some places.

    A dot is found where the brightest value within half a spacing stands five times as high
    above what lies between the dots around it as that is uneven (`rose1948`).

    Parameters
    ----------
    picture
        (rows, columns), linear.
    places
        Row and column where each dot should be, in pixels.
    spacings
        Distance of neighbouring dots around each, in pixels.

    Returns
    -------
    list
        One for each place; None where there is no dot, or its part of the grid is not in the
        picture.
    """
    values = picture.double().numpy()
    faintest = _FAINTEST * float(abs(values).max())
    clear = np.ones(values.shape, dtype=bool)
    for place, spacing in zip(places, spacings, strict=True):
        window = _window(place, _CLEAR * spacing, values.shape)
        rows, columns = np.ogrid[window]
        away = (rows - place[0]) ** 2 + (columns - place[1]) ** 2
        clear[window] &= away > (_CLEAR * spacing) ** 2
    return [
        _spot(values, clear, place, spacing, faintest)
        for place, spacing in zip(places, spacings, strict=True)
    ]


def brightest_places(picture: Tensor) -> list[tuple[float, float]]:
    """Places of pixels, not at the edge, that are the highest of their 3×3 and not faint.

    Those count that stand at least a quarter as high over the median as the very highest one.

    Parameters
    ----------
    picture
        (rows, columns).

    Returns
    -------
    list
        Row and column, between the pixels by parabolas.
    """
    values = picture.double().numpy()
    above = np.clip(values - np.median(values), 0, None)
    top = (scipy.ndimage.maximum_filter(above, 3) == above) & (above >= _FAINT * above.max())
    top &= above > 0
    places = []
    # At the very edge, what is highest may be the side of a dot beyond it.
    for row, column in np.argwhere(top[1:-1, 1:-1]) + 1:
        near = above[row - 1 : row + 2, column - 1 : column + 2]
        places.append((float(row + _vertex(near[:, 1])), float(column + _vertex(near[1]))))
    return places


def _spot(
    values: NDArray[np.float64],
    clear: NDArray[np.bool_],
    place: tuple[float, float],
    spacing: float,
    faintest: float,
) -> Spot | None:
    rows, columns = values.shape
    if not (0 <= place[0] <= rows - 1 and 0 <= place[1] <= columns - 1):
        return None
    around = _window(place, max(_AROUND * spacing, 3.0), values.shape)
    between = values[around][clear[around]]
    if len(between) < _LEAST_CLEAR:
        between = np.sort(values[around], axis=None)[: max(1, values[around].size // 4)]
    level = float(np.median(between))
    uneven = float(np.sqrt(np.mean((between - level) ** 2)))
    at, fine = _finer(values, place, spacing / 2)
    away = np.hypot(at[0][:, None] - place[0], at[1] - place[1])
    fine = np.where(away <= spacing / 2, fine - level, -np.inf)
    top = np.unravel_index(int(np.argmax(fine)), fine.shape)
    peak = float(fine[top])
    if not peak > max(_ROSE * uneven, faintest):
        return None
    labels, _ = scipy.ndimage.label(fine >= _HALF * peak)
    own = labels == labels[top]
    weight = np.where(own, fine - _HALF * peak, 0.0)
    weight[top] += 1e-12 * peak
    whole = _window(place, spacing / 2, values.shape)
    light = float((values[whole] - level).sum())
    return Spot(
        place=(
            float((weight.sum(axis=1) * at[0]).sum() / weight.sum()),
            float((weight.sum(axis=0) * at[1]).sum() / weight.sum()),
        ),
        width=2 * math.sqrt(float(own.sum()) / math.pi) / _FINER,
        light=light,
        peak=peak,
    )


def _vertex(three: NDArray[np.float64]) -> float:
    """Where a parabola through three values has its top, from the middle one."""
    before, middle, after = (float(each) for each in three)
    bend = 2 * middle - before - after
    return 0.5 * (after - before) / bend if bend > 0 else 0.0


def _finer(
    values: NDArray[np.float64], place: tuple[float, float], extent: float
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]:
    """Rows, columns and cubic interpolation between the pixels around a place."""
    at = []
    for middle, count in zip(place, values.shape, strict=True):
        low = max(0.0, math.floor(middle - extent))
        high = min(count - 1.0, math.ceil(middle + extent))
        at.append(np.arange(low, high + 0.5 / _FINER, 1 / _FINER))
    start = [max(0, int(each[0]) - _BEYOND) for each in at]
    stop = [int(each[-1]) + _BEYOND + 1 for each in at]
    part = values[start[0] : stop[0], start[1] : stop[1]]
    grid = np.meshgrid(at[0] - start[0], at[1] - start[1], indexing="ij")
    fine: NDArray[np.float64] = scipy.ndimage.map_coordinates(part, grid, order=3, mode="nearest")
    return (at[0], at[1]), fine


def _window(
    place: tuple[float, float], extent: float, shape: tuple[int, ...]
) -> tuple[slice, slice]:
    rows, columns = (
        slice(max(0, math.ceil(middle - extent)), min(count, math.floor(middle + extent) + 1))
        for middle, count in zip(place, shape, strict=True)
    )
    return rows, columns


@dataclass(frozen=True)
class Dot:
    """One dot of a grid, as it should be and as it is.

    Parameters
    ----------
    angle_deg
        Between the axis and the ray to it.
    expected
        Row and column of the picture where rays put it.
    position
        Where it is; None if it was not found.
    error_pixels, error_deg
        How far that is off, in pixels and as an angle in the scene.
    width_pixels, width
        Of the dot, in pixels and in widths of the middle dots.
    light
        Of the dot, in light of the middle dots.
    expected_light
        What the angle, the pixels and the plane's slant leave of it.
    grade
        See `grade`.
    """

    angle_deg: float
    expected: tuple[float, float]
    position: tuple[float, float] | None
    error_pixels: float | None
    error_deg: float | None
    width_pixels: float | None
    width: float | None
    light: float | None
    expected_light: float
    grade: Grade


@dataclass(frozen=True)
class Angles:
    """Half angles of the field.

    Parameters
    ----------
    good_deg
        Dots are good up to here; None: not even in the middle.
    distorted_deg
        Dots are found up to here, good or not; None: nowhere.
    lost_deg
        Dots are lost from here on; None: nowhere.
    """

    good_deg: float | None
    distorted_deg: float | None
    lost_deg: float | None


def grade(
    *,
    width: float,
    error: float,
    light: float,
    widest: float = math.sqrt(2),
    farthest: float = 0.5,
    least_light: float = 0.5,
    faint_light: float = 0.1,
) -> Grade:
    """Judge a dot that was found.

    The paper calls dots beyond 45° aberrated with coma, field curvature and vignetting, and says
    no figure (`uvimprint`, fig. 6d); these are common ones for each of the three.

    Parameters
    ----------
    width
        In widths of the middle dots.
    error
        How far off it is, in widths of the middle dots.
    light
        Over what is expected of it.
    widest
        From here on it is distorted: twice the area.
    farthest
        From here on it is distorted: it reaches out of its own place.
    least_light
        Below it is distorted: half of it went elsewhere.
    faint_light
        Below it is lost: what is left is as faint as what a picture is cluttered with.
    """
    if light < faint_light:
        return "lost"
    if width > widest or error > farthest or light < least_light:
        return "distorted"
    return "good"


def angles_of(dots: Sequence[Dot]) -> Angles:
    """Angles that part good dots from others, and dots that are found from lost ones, best.

    Each is the place between two neighbouring angles with the fewest dots on the wrong side.

    Parameters
    ----------
    dots
        In any order.
    """
    ordered = sorted(dots, key=lambda dot: dot.angle_deg)
    at = [dot.angle_deg for dot in ordered]
    good = _inside(ordered, lambda dot: dot.grade == "good")
    visible = _inside(ordered, lambda dot: dot.grade != "lost")
    return Angles(
        good_deg=at[good - 1] if good else None,
        distorted_deg=at[visible - 1] if visible else None,
        lost_deg=at[visible] if visible < len(at) else None,
    )


def _inside(ordered: Sequence[Dot], holds: Callable[[Dot], bool]) -> int:
    """How many of the first dots to take, so that the fewest are wrong; the most of those."""
    right = np.array([holds(dot) for dot in ordered])
    wrong = np.concatenate([[0], np.cumsum(~right)]) + (
        right.sum() - np.concatenate([[0], np.cumsum(right)])
    )
    # Dots of one angle stand together.
    at = np.array([round(dot.angle_deg, 6) for dot in ordered])
    ends = np.concatenate([[True], at[1:] != at[:-1], [True]])
    wrong = np.where(ends, wrong, len(ordered) + 1)
    return int(len(wrong) - 1 - np.argmin(wrong[::-1]))
