"""Targets on a flat screen: their drawings, and angles in pictures of them."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

_OVERSAMPLING = 4


@dataclass(frozen=True)
class FlatPicture:
    """A picture on evenly spaced tangents of the field angle, as a flat screen has it.

    Parameters
    ----------
    values
        (height, width).
    tangent
        From pixel to pixel.
    axis
        Row and column that the optical axis falls on.
    """

    values: Tensor
    tangent: float
    axis: tuple[float, float]

    def angle_deg(
        self, place: tuple[float, float], direction: tuple[float, float], pixels: float
    ) -> float:
        r"""Angle under which the camera sees a short length on the screen.

        With the screen at distance 1, :math:`dθ^2 = [(1+t^2)\,dl^2 - (\vec t\cdot d\vec l)^2] /
        (1+t^2)^2`: across the way to the axis it is smaller by :math:`\cos θ`, along it by
        :math:`\cos^2 θ`.

        Parameters
        ----------
        place
            Row and column at which the length lies.
        direction
            Of the length, (row, column); a unit vector.
        pixels
            How long it is.
        """
        row, column = (
            (each - axis) * self.tangent for each, axis in zip(place, self.axis, strict=True)
        )
        squared = 1 + row**2 + column**2
        along = row * direction[0] + column * direction[1]
        length = pixels * self.tangent
        return math.degrees(length * math.sqrt(squared - along**2) / squared)


def pixel_means(value: Callable[[Tensor, Tensor], Tensor], side: int) -> Tensor:
    """Draw a square: the mean over each pixel of a function of the place.

    Parameters
    ----------
    value
        Of places to the right and up, both from -1 to 1, as tensors.
    side
        Pixels along the square.

    Returns
    -------
    Tensor
        (side, side).
    """
    fine = side * _OVERSAMPLING
    at = (torch.arange(fine, dtype=torch.float64) + 0.5) / fine * 2 - 1
    values = value(at.expand(fine, -1), -at[:, None].expand(-1, fine))
    return nnf.avg_pool2d(values[None], _OVERSAMPLING)[0]
