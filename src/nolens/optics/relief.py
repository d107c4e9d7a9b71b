"""Surfaces of masks: heights in µm on a grid, and their values between the samples."""

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from nolens.optics.grid import Grid


@dataclass(frozen=True)
class Relief:
    """Heights towards the scene, on a grid around the sensor's middle.

    Parameters
    ----------
    height_um
        float32, (rows, columns).
    grid_um
        Distance of the samples.
    """

    height_um: Tensor
    grid_um: float

    @property
    def extent_um(self) -> tuple[float, float]:
        """Height and width of the surface."""
        rows, columns = self.height_um.shape
        return (rows - 1) * self.grid_um, (columns - 1) * self.grid_um

    @cached_property
    def steepest(self) -> float:
        """Largest slope between neighbouring samples, along the rows or the columns."""
        steps = [self.height_um.diff(dim=axis).abs() for axis in (0, 1)]
        return (
            max((float(step.max()) for step in steps if step.numel()), default=0.0) / self.grid_um
        )

    def sample(self, grid: Grid) -> Tensor:
        """Heights on another grid, by cubic polynomials through four neighbours.

        The surface goes on level beyond its edges.

        Returns
        -------
        Tensor
            float32, (rows, columns), on the surface's device.
        """
        values = self.height_um
        for axis in (0, 1):
            count = self.height_um.shape[axis]
            place = grid.positions_um(axis) / self.grid_um + (count - 1) / 2
            first = place.floor()
            weights = _lagrange(place - first).to(values)
            rows = first.to(torch.int64).to(values.device)
            shape = [1, 1]
            shape[axis] = len(rows)
            total: Tensor | None = None
            for step, weight in enumerate(weights):
                at = (rows + (step - 1)).clamp(0, count - 1)
                part = values.index_select(axis, at).mul_(weight.view(shape))
                total = part if total is None else total.add_(part)
            assert total is not None
            values = total
        return values


def _lagrange(t: Tensor) -> Tensor:
    """Weights of the samples at −1, 0, 1, 2 for the place t in 0…1, (4, …)."""
    return torch.stack(
        [
            -t * (t - 1) * (t - 2) / 6,
            (t + 1) * (t - 1) * (t - 2) / 2,
            -(t + 1) * t * (t - 2) / 2,
            (t + 1) * t * (t - 1) / 6,
        ]
    )
