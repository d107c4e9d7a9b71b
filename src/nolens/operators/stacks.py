"""Operators side by side: several measurements of one scene, several scenes, or both."""

from collections.abc import Sequence
from functools import reduce
from operator import add
from typing import ClassVar

import torch
from torch import Tensor

from nolens.operators.base import LinearOperator


class _Stack(LinearOperator):
    """Operators along a new axis, in front of the axes that one of them takes or gives.

    Parameters
    ----------
    operators
        One or more, all of one domain and range.

    Raises
    ------
    ValueError
        If there is none, or their shapes differ.
    """

    _of_domain: ClassVar[bool]
    _of_range: ClassVar[bool]

    def __init__(self, operators: Sequence[LinearOperator]) -> None:
        self.operators = tuple(operators)
        shapes = sorted({(each.domain_shape, each.range_shape) for each in self.operators})
        if len(shapes) != 1:
            raise ValueError(
                f"a {type(self).__name__} takes operators of one domain and range, and got "
                f"{shapes}; give a solver one term for each instead"
            )
        ((self._domain, self._range),) = shapes

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """That of one operator, with the new axis in front where scenes are stacked."""
        return (*([len(self.operators)] if self._of_domain else []), *self._domain)

    @property
    def range_shape(self) -> tuple[int, ...]:
        """That of one operator, with the new axis in front where measurements are stacked."""
        return (*([len(self.operators)] if self._of_range else []), *self._range)

    def _forward(self, v: Tensor) -> Tensor:
        parts = self._parts(v, self._domain, self._of_domain)
        images = [each._forward(part) for each, part in zip(self.operators, parts, strict=True)]
        return _joined(images, self._range, self._of_range)

    def _adjoint(self, y: Tensor) -> Tensor:
        parts = self._parts(y, self._range, self._of_range)
        scenes = [each._adjoint(part) for each, part in zip(self.operators, parts, strict=True)]
        return _joined(scenes, self._domain, self._of_domain)

    def _parts(self, tensor: Tensor, shape: tuple[int, ...], stacked: bool) -> Sequence[Tensor]:
        return tensor.unbind(dim=-len(shape) - 1) if stacked else [tensor] * len(self.operators)


def _joined(parts: list[Tensor], shape: tuple[int, ...], stacked: bool) -> Tensor:
    return torch.stack(parts, dim=-len(shape) - 1) if stacked else reduce(add, parts)


class VerticalStack(_Stack):
    """Several measurements of one scene: v ↦ (A₁v, A₂v, …)."""

    _of_domain, _of_range = False, True


class HorizontalStack(_Stack):
    """Several scenes to one measurement: (v₁, v₂, …) ↦ A₁v₁ + A₂v₂ + …."""

    _of_domain, _of_range = True, False


class BlockDiagonal(_Stack):
    """Several scenes, a measurement of each: (v₁, v₂, …) ↦ (A₁v₁, A₂v₂, …)."""

    _of_domain, _of_range = True, True
