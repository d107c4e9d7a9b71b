"""The mask's surface: relief and opening, and the samples of a plane."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import torch
from torch import Tensor


@dataclass(frozen=True)
class Grid:
    """Square samples in a plane parallel to the sensor.

    Rows count downwards and columns to the right, as in the picture that the camera gives.

    Parameters
    ----------
    rows, columns
        Number of samples.
    pitch_um
        Their distance.
    centre_um
        Where the middle of the grid lies, (row, column) direction, from the sensor's middle.
    """

    rows: int
    columns: int
    pitch_um: float
    centre_um: tuple[float, float] = (0.0, 0.0)

    def positions_um(self, axis: int) -> Tensor:
        """Places of the rows (0) or columns (1), float64."""
        count = (self.rows, self.columns)[axis]
        steps = torch.arange(count, dtype=torch.float64) - (count - 1) / 2
        return self.centre_um[axis] + steps * self.pitch_um

    @property
    def extent_um(self) -> tuple[float, float]:
        """Height and width."""
        return self.rows * self.pitch_um, self.columns * self.pitch_um

    def finer(self, factor: int) -> "Grid":
        """The same area with `factor`² times the samples."""
        return Grid(
            self.rows * factor, self.columns * factor, self.pitch_um / factor, self.centre_um
        )


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


@dataclass(frozen=True)
class Opening:
    """A hole in an opaque film, around the sensor's middle.

    Parameters
    ----------
    shape
        "rectangle" or "ellipse".
    height_um, width_um
        Its size.
    """

    shape: Literal["rectangle", "ellipse"]
    height_um: float
    width_um: float

    def coverage(self, rows_um: Tensor, columns_um: Tensor, pitch_um: float) -> Tensor:
        """Fraction of each square sample that is open, (rows, columns), float32."""
        if self.shape == "rectangle":
            sides = [
                (0.5 + (size / 2 - place.abs()) / pitch_um).clamp(0, 1).float()
                for size, place in ((self.height_um, rows_um), (self.width_um, columns_um))
            ]
            return sides[0][:, None] * sides[1]
        y, x = rows_um[:, None] / self.height_um, columns_um / self.width_um
        radius = 2 * torch.hypot(y.expand(-1, len(x)), x.expand(len(y), -1))
        # Distance to the edge: that of the level line, by its value over its gradient.
        steepness = 4 * torch.hypot(y / self.height_um, x / self.width_um) / radius.clamp_min(1e-9)
        return (0.5 + (1 - radius) / (steepness * pitch_um).clamp_min(1e-9)).clamp(0, 1).float()


@dataclass(frozen=True)
class MaskSurface:
    """Relief between two media, and the opening in front of it.

    Parameters
    ----------
    relief
        Heights towards the scene.
    opening
        None where the whole surface is open.
    """

    relief: Relief
    opening: Opening | None = None

    def coarsest_pitch_um(
        self, wavelength_um: float, coupling: float, divergence: float = 0.0
    ) -> float:
        """Largest distance of samples that carries light of a wavelength behind the relief.

        The relief turns the phase by `coupling` · slope / λ turns in a µm; four samples to the
        fastest turn leave room for what diffraction adds. Two samples more are for each turn of
        a wave that diverges by `divergence` (in p) within a window.
        """
        turn = (2 * abs(coupling) * self.relief.steepest + divergence) / wavelength_um
        return 1 / (2 * turn) if turn > 0 else float("inf")
