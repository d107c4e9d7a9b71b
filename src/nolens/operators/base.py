"""What every linear operator has: a forward map, its adjoint, and gradients through both."""

from abc import ABC, abstractmethod
from typing import Any

from torch import Tensor
from torch.autograd import Function


class LinearOperator(ABC):
    r"""A linear map A with its adjoint, ⟨A v, y⟩ = ⟨v, A* y⟩.

    Subclasses write `_forward` and `_adjoint`; calling the operator, or `adjoint`, records the
    gradient: the derivative of A is A itself, so the gradient of a loss L(A v) is A* ∇L. That
    holds for kernels that torch cannot see into, such as scipy's transforms.
    """

    @property
    @abstractmethod
    def domain_shape(self) -> tuple[int, ...]:
        """Trailing axes of what the operator takes."""

    @property
    @abstractmethod
    def range_shape(self) -> tuple[int, ...]:
        """Trailing axes of what the operator gives."""

    @abstractmethod
    def _forward(self, v: Tensor) -> Tensor: ...

    @abstractmethod
    def _adjoint(self, y: Tensor) -> Tensor: ...

    def __call__(self, v: Tensor) -> Tensor:
        """Apply A.

        Parameters
        ----------
        v
            Tensor whose last axes are `domain_shape`.

        Raises
        ------
        ValueError
            If the last axes are others.
        """
        _check_shape(v, self.domain_shape, type(self).__name__)
        return _apply(v, self, False)

    def adjoint(self, y: Tensor) -> Tensor:
        """Apply A*, the adjoint.

        Parameters
        ----------
        y
            Tensor whose last axes are `range_shape`.

        Raises
        ------
        ValueError
            If the last axes are others.
        """
        _check_shape(y, self.range_shape, f"adjoint of {type(self).__name__}")
        return _apply(y, self, True)


class _Apply(Function):
    """A linear operator as a node of torch's graph."""

    @staticmethod
    def forward(ctx: Any, v: Tensor, operator: LinearOperator, adjoint: bool) -> Tensor:
        ctx.operator, ctx.is_adjoint = operator, adjoint
        return operator._adjoint(v.detach()) if adjoint else operator._forward(v.detach())

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor, None, None]:
        (gradient,) = gradients
        return _apply(gradient, ctx.operator, not ctx.is_adjoint), None, None


def _apply(v: Tensor, operator: LinearOperator, adjoint: bool) -> Tensor:
    out: Tensor = _Apply.apply(v, operator, adjoint)  # type: ignore[no-untyped-call]
    return out


def _check_shape(tensor: Tensor, shape: tuple[int, ...], name: str) -> None:
    if tuple(tensor.shape[-len(shape) :]) != shape:
        raise ValueError(
            f"{name} takes tensors that end in {shape}, and got one of {tuple(tensor.shape)}"
        )
