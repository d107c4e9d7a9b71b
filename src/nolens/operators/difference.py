"""Finite differences between neighbouring pixels."""

from collections.abc import Iterator

import torch
from torch import Tensor

from nolens.kernels import difference_rows
from nolens.operators.base import LinearOperator

_BAND = 200_000
"""Pixels of a band."""


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

    def bands(self, v: Tensor) -> Iterator[Tensor]:
        """Rows of Ψv, (..., 2, rows, width), some at a time: they need less memory than all.

        Parameters
        ----------
        v
            (..., height, width).
        """
        height, width = self.shape
        step = max(1, _BAND // width)
        for first in range(0, height, step):
            yield difference_rows(v, slice(first, min(first + step, height)))


class StackDifference(LinearOperator):
    r"""Differences to the next pixel of a stack of scenes, dark around each, and to the next slice.

    (Ψv)₀ = a (v[k+1] − v[k]), and zero after the last slice; (Ψv)₁ and (Ψv)₂ as those of
    `FiniteDifference` of scenes with a dark pixel after the last.

    Parameters
    ----------
    shape
        (slices, height, width).
    across
        a, how much the differences between slices weigh.

    Notes
    -----
    Takes `(..., slices, height, width)`, gives `(..., 3, slices, height + 1, width + 1)`.
    """

    def __init__(self, shape: tuple[int, int, int], across: float = 1.0) -> None:
        self.shape, self.across = shape, across

    @property
    def domain_shape(self) -> tuple[int, int, int]:
        """Size of the stack."""
        return self.shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """A difference along each axis for each pixel, and for the dark ones."""
        slices, height, width = self.shape
        return 3, slices, height + 1, width + 1

    def _forward(self, v: Tensor) -> Tensor:
        out = v.new_zeros((*v.shape[:-3], *self.range_shape))
        height, width = self.shape[1:]
        across, down, right = out.unbind(-4)
        across[..., :-1, :height, :width] = self.across * (v[..., 1:, :, :] - v[..., :-1, :, :])
        for axis, part in ((-2, down[..., :width]), (-1, right[..., :height, :])):
            length = v.shape[axis]
            part.narrow(axis, 0, length).sub_(v)
            part.narrow(axis, 0, length - 1).add_(v.narrow(axis, 1, length - 1))
            part.narrow(axis, length, 1).add_(v.narrow(axis, 0, 1))
        return out

    def _adjoint(self, y: Tensor) -> Tensor:
        height, width = self.shape[1:]
        across, down, right = y.unbind(-4)
        out = -down[..., :height, :width] - right[..., :height, :width]
        for axis, part in ((-2, down[..., :width]), (-1, right[..., :height, :])):
            length = out.shape[axis]
            out.narrow(axis, 1, length - 1).add_(part.narrow(axis, 0, length - 1))
            out.narrow(axis, 0, 1).add_(part.narrow(axis, length, 1))
        steps = self.across * across[..., :-1, :height, :width]
        out[..., 1:, :, :] += steps
        out[..., :-1, :, :] -= steps
        return out
