"""Finite differences between neighbouring pixels."""

import torch
from torch import Tensor

from nolens.operators.base import LinearOperator


class FiniteDifference(LinearOperator):
    r"""Differences to the next pixel along each axis, periodic: Ψ of eq. 7.

    (Ψv)₀[i, j] = v[i+1, j] − v[i, j] and (Ψv)₁[i, j] = v[i, j+1] − v[i, j].

    Parameters
    ----------
    shape
        (height, width) of the scene; three numbers for a volume or a video.

    Notes
    -----
    Takes `(..., height, width)`, gives `(..., 2, height, width)`.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = tuple(shape)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the scene."""
        return self.shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """A difference along each axis for each pixel."""
        return (len(self.shape), *self.shape)

    def _forward(self, v: Tensor) -> Tensor:
        axes = range(-len(self.shape), 0)
        return torch.stack([torch.roll(v, -1, k) - v for k in axes], dim=-len(self.shape) - 1)

    def _adjoint(self, y: Tensor) -> Tensor:
        first, *others = (
            torch.roll(each, 1, k) - each
            for k, each in enumerate(y.unbind(dim=-len(self.shape) - 1), start=-len(self.shape))
        )
        return sum(others, start=first)
