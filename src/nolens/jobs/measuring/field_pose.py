"""How a grid of dots stands before a camera: turned, beside the axis, and how far apart."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch

from nolens.errors import DataError

_FEWEST = 5
_OFF = 0.15
_PASSES = 3
_NEAR = 0.3
"""Pitches from a grid's place within which a bright place is taken for a dot of it."""


@dataclass(frozen=True)
class Pose:
    """A grid in the plane of tangents, its axes turned and its nearest dot beside the axis.

    Parameters
    ----------
    pitch_mm
        Distance of its dots, as found.
    turned_deg
        By how much its rows are turned clockwise in the picture, -45 to 45.
    beside
        Tangents, (row, column), of the dot nearest to the axis.
    asked
        Tangent of the pitch that it was said to have.
    """

    pitch_mm: float
    turned_deg: float
    beside: tuple[float, float]
    asked: float
    _step: complex

    @classmethod
    def of(cls, tops: Sequence[tuple[float, float]], pitch_um: float, distance_um: float) -> "Pose":
        r"""Fit a square grid to the dots in the middle of a picture.

        The direction is that of neighbours, by :math:`\arg Σ e^{4iφ} / 4`; then
        :math:`z = a k + b` for the whole numbers k of the dots, by least squares.

        Parameters
        ----------
        tops
            Tangents, (row, column), of bright places.
        pitch_um, distance_um
            What the grid was said to have.

        Raises
        ------
        DataError
            If there are too few, or their pitch is another one.
        """
        asked = pitch_um / distance_um
        if len(tops) < _FEWEST:
            raise DataError(
                f"the middle of the picture has {len(tops)} bright dots, of which a grid has "
                f"{_FEWEST} or more: check that the picture is of a grid of dots"
            )
        places = torch.tensor(
            [complex(column, row) for row, column in tops], dtype=torch.complex128
        )
        away = (places[:, None] - places).abs() + torch.eye(len(places)) * 1e9
        nearest = away.argmin(dim=1)
        gap = float(away.min(dim=1).values.median())
        to_mm = distance_um * 1e-3
        if not math.isclose(gap, asked, rel_tol=_OFF):
            raise DataError(
                f"the dots in the middle of the picture lie {gap * to_mm:.3g} mm apart at "
                f"{to_mm:g} mm, not {pitch_um * 1e-3:g} mm: give the pitch and distance that the "
                "target has (--dot-pitch, --distance), and the camera it was taken with"
            )
        neighbours = (places[nearest] - places)[away.min(dim=1).values < 1.3 * gap]
        direction = cmath.phase(complex(((neighbours / neighbours.abs()) ** 4).sum())) / 4
        step = cmath.rect(gap, direction)
        origin = complex(places[places.abs().argmin()])
        for _ in range(_PASSES):
            exact = (places - origin) / step
            numbers = _whole(exact)
            on = (exact - numbers).abs() < _NEAR
            numbers, there = numbers[on], places[on]
            middle = numbers.mean()
            spread = numbers - middle
            step = complex((there * spread.conj()).sum() / (spread.abs() ** 2).sum())
            origin = complex(there.mean()) - step * complex(middle)
        turned = math.remainder(cmath.phase(step), math.pi / 2)
        step = cmath.rect(abs(step), turned)
        origin -= step * complex(_whole(torch.tensor(origin / step, dtype=torch.complex128)))
        return cls(abs(step) * to_mm, math.degrees(turned), (origin.imag, origin.real), asked, step)

    def tangent(self, number: tuple[float, float]) -> tuple[float, float]:
        """Where a dot is that an upright grid on the axis has at some tangents, (row, column)."""
        upright = complex(number[1], number[0]) / self.asked
        place = complex(self.beside[1], self.beside[0]) + self._step * upright
        return place.imag, place.real


def _whole(numbers: torch.Tensor) -> torch.Tensor:
    return torch.complex(numbers.real.round(), numbers.imag.round())
