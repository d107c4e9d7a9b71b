"""Rays from a plane before a camera to the cells of its picture, many at once, by Snell's law."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.optics import Stack
from nolens.twin import Twin

Places = list[tuple[float, float]]
"""Rows and columns, or the tangents of field angles in their directions."""


@dataclass(frozen=True)
class Rays:
    """A camera's layers over the cells of a picture.

    Parameters
    ----------
    twin
        The camera.
    stack
        Its layers.
    axis
        Row and column of the cell that lies on the axis.
    """

    twin: Twin
    stack: Stack
    axis: tuple[int, int]

    @classmethod
    def of(cls, twin: Twin, size: tuple[int, int]) -> "Rays":
        """For a picture of (rows, columns): all of the sensor, or a region around its middle."""
        rows, columns = (
            cells // 2 - (cells - count) // 2 for cells, count in zip(twin.cells, size, strict=True)
        )
        return cls(twin, twin.stack(), (rows, columns))

    def cells(self, tangents: Places) -> Places:
        """Where the light of some directions falls."""
        at, reach, p = self._sines(tangents)
        moved = self.stack.displacement_um(p) / self.twin.cell_um
        scale = torch.where(reach > 0, moved / reach.clamp_min(1e-12), 0.0)
        return _pairs(at * scale[:, None] + torch.tensor(self.axis, dtype=torch.float64))

    def tangents(self, cells: Places) -> Places:
        """From where light falls on some places."""
        away = torch.tensor(cells, dtype=torch.float64) - torch.tensor(self.axis)
        away = away * self.twin.cell_um
        reach = away.norm(dim=1)
        p = self.stack.ray(reach)
        tangent = p / (1 - p * p).sqrt()
        return _pairs(away * torch.where(reach > 0, tangent / reach.clamp_min(1e-12), 0.0)[:, None])

    def spacings(self, tangents: Places, step: float) -> list[float]:
        """Cells between dots whose tangents are a step apart, in the direction that is nearer."""
        _, reach, p = self._sines(tangents)
        along = self.stack.spread_um(p) * (1 - p * p).pow(1.5)
        across = torch.where(
            reach > 0, self.stack.displacement_um(p) / reach.clamp_min(1e-12), self.stack.reduced_um
        )
        spacings: list[float] = (torch.minimum(along, across) * (step / self.twin.cell_um)).tolist()
        return spacings

    def light(self, tangents: Places) -> list[float]:
        """Light of dots on a plane, 1 on the axis: cos θ for its slant, and `Twin.vignetting`."""
        _, _, p = self._sines(tangents)
        light: list[float] = ((1 - p * p).sqrt() * self.twin.vignetting(p)).tolist()
        return light

    def _sines(self, tangents: Places) -> tuple[Tensor, Tensor, Tensor]:
        at = torch.tensor(tangents, dtype=torch.float64).reshape(-1, 2)
        reach = at.norm(dim=1)
        return at, reach, reach / (1 + reach * reach).sqrt()


def between_deg(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Angle between the rays of two tangents."""
    across = (
        one[0] - other[0], one[1] - other[1], one[0] * other[1] - one[1] * other[0],
    )  # fmt: skip
    return math.degrees(math.atan2(math.hypot(*across), 1 + one[0] * other[0] + one[1] * other[1]))


def _pairs(values: Tensor) -> Places:
    return [(row, column) for row, column in values.tolist()]
