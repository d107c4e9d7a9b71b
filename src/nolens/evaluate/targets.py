"""Pictures of test targets, and angles of what is seen on them."""

import math
from collections.abc import Callable

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import OptionError

_FINER = 4
STAR_SHARE = 0.96
"""Diameter of the star to the side of its picture."""


def siemens_star(side: int, periods: int) -> Tensor:
    """Bright and dark spokes around the middle of a square; dark beside the star.

    Parameters
    ----------
    side
        Pixels along the square.
    periods
        Bright spokes.

    Returns
    -------
    Tensor
        (side, side), 0 to 1; each pixel the mean over its area.

    Raises
    ------
    OptionError
        If there are fewer than 4 bright spokes.
    """
    if periods < 4:
        raise OptionError(f"a star of {periods} bright spokes: give at least 4, such as 36")

    def value(right: Tensor, up: Tensor) -> Tensor:
        turned = torch.atan2(up, right) * (periods / (2 * math.pi))
        bright = (turned - turned.round()).abs() < 0.25
        return (bright & (torch.hypot(right, up) <= STAR_SHARE)).float()

    return _averaged(value, side)


def star_square_deg(angle_deg: float) -> float:
    """Field angle of the side of a star's square, by that of the star from side to side."""
    return 2 * math.degrees(math.atan(math.tan(math.radians(angle_deg) / 2) / STAR_SHARE))


def slanted_edge(side: int, tilt_deg: float) -> Tensor:
    """Dark at the left, bright at the right of an edge through the middle of a square.

    Parameters
    ----------
    side
        Pixels along the square.
    tilt_deg
        Of the edge from upright, to the left at its top.

    Returns
    -------
    Tensor
        (side, side), 0 to 1; each pixel the mean over its area.
    """
    tilt = math.tan(math.radians(tilt_deg))
    return _averaged(lambda right, up: (right + tilt * up > 0).float(), side)


def angle_of_length(
    place: tuple[float, float], direction: tuple[float, float], length: float
) -> float:
    r"""Angle in degrees under which the camera sees a short length on a flat screen.

    With the screen at distance 1, :math:`dθ^2 = [(1+t^2)\,dl^2 - (\vec t\cdot d\vec l)^2] /
    (1+t^2)^2`: across the way to the axis it is smaller by :math:`\cos θ`, along it by
    :math:`\cos^2 θ`.

    Parameters
    ----------
    place
        Tangents of the field angle at which it lies, (row, column).
    direction
        Of the length there; a unit vector.
    length
        In units of the screen's distance.
    """
    squared = 1 + place[0] ** 2 + place[1] ** 2
    along = place[0] * direction[0] + place[1] * direction[1]
    return math.degrees(length * math.sqrt(squared - along**2) / squared)


def _averaged(value: Callable[[Tensor, Tensor], Tensor], side: int) -> Tensor:
    """Mean over each pixel of a function of the place, from -1 to 1 to the right and up."""
    fine = side * _FINER
    at = (torch.arange(fine, dtype=torch.float64) + 0.5) / fine * 2 - 1
    values = value(at.expand(fine, -1), -at[:, None].expand(-1, fine))
    return nnf.avg_pool2d(values[None], _FINER)[0]
