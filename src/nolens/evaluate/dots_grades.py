"""Which dots of a grid are good, distorted or lost, and up to which angle."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

Grade = Literal["good", "distorted", "lost"]


@dataclass(frozen=True)
class Dot:
    """One dot of a grid, as it should be and as it was found.

    Parameters
    ----------
    angle_deg
        Between the axis and the ray to it.
    expected
        Row and column of the picture where rays put it.
    found
        Where it is; None if it was not found.
    error_cells, error_deg
        How far that is off, in cells and as an angle in the scene.
    width_cells, width
        Of the dot, in cells and in widths of the middle dots.
    light
        Of the dot, in light of the middle dots.
    expected_light
        What the angle, the pixels and the plane's slant leave of it.
    grade
        See `grade`.
    """

    angle_deg: float
    expected: tuple[float, float]
    found: tuple[float, float] | None
    error_cells: float | None
    error_deg: float | None
    width_cells: float | None
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
    seen_light: float = 0.1,
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
    seen_light
        Below it is lost: what is left is as faint as what a picture is cluttered with.
    """
    if light < seen_light:
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
    seen = _inside(ordered, lambda dot: dot.grade != "lost")
    return Angles(
        good_deg=at[good - 1] if good else None,
        distorted_deg=at[seen - 1] if seen else None,
        lost_deg=at[seen] if seen < len(at) else None,
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
