"""Finite differences between neighbouring pixels."""

import torch
from torch import Tensor

from nolens.operators.base import LinearOperator


class FiniteDifference(LinearOperator):
    r"""Differences to the next row and to the next column, periodic: Ψ of eq. 7.

    (Ψv)₀[i, j] = v[i+1, j] − v[i, j] and (Ψv)₁[i, j] = v[i, j+1] − v[i, j].

    Parameters
    ----------
    shape
        (height, width) of the scene.

    Notes
    -----
    Takes `(..., height, width)`, gives `(..., 2, height, width)`.
    """

    def __init__(self, shape: tuple[int, int]) -> None:
        self.shape = shape

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the scene."""
        return self.shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Two differences for each pixel."""
        return (2, *self.shape)

    def _forward(self, v: Tensor) -> Tensor:
        return torch.stack([torch.roll(v, -1, -2) - v, torch.roll(v, -1, -1) - v], dim=-3)

    def _adjoint(self, y: Tensor) -> Tensor:
        rows, columns = y.unbind(dim=-3)
        return torch.roll(rows, 1, -2) - rows + torch.roll(columns, 1, -1) - columns
