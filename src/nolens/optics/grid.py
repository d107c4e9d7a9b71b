"""Where the samples of a plane lie."""

from dataclasses import dataclass

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
