"""What every linear operator has: a forward map, its adjoint, gradients, and the algebra."""

import math
from abc import ABC, abstractmethod
from typing import Any, overload

import torch
from torch import Tensor
from torch.autograd import Function


class LinearOperator(ABC):
    r"""A linear map A with its adjoint, ⟨A v, y⟩ = ⟨v, A* y⟩.

    Subclasses write `_forward` and `_adjoint`; calling the operator, or `adjoint`, records the
    gradient: the derivative of A is A itself, so the gradient of a loss L(A v) is A* ∇L. That
    holds for kernels that torch cannot see into, such as scipy's transforms.

    Operators make operators: ``A.H`` is the adjoint, ``A @ B`` applies B first, ``A + B``,
    ``A - B``, ``2 * A`` and ``-A`` are what they say. ``A @ v`` is ``A(v)``.
    """

    __array_ufunc__ = None  # NumPy's numbers leave `number * operator` to the operator.

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

    @property
    def H(self) -> "LinearOperator":  # noqa: N802 (as the field writes it)
        """The adjoint as an operator."""
        return Adjoint(self)

    def gram(self) -> "LinearOperator":
        """A*A."""
        return self.H @ self

    def norm(
        self, like: Tensor | None = None, *, tolerance: float = 1e-3, iterations: int = 200
    ) -> float:
        r"""‖A‖, the largest singular value, from below, by power iteration on A*A (`golub2013`).

        Parameters
        ----------
        like
            A tensor whose precision and device to compute with, and whose leading axes to take;
            None for `domain_shape` in float32 on the CPU. The start is random and always the same.
        tolerance
            Ends when an iteration changes the value by less than this fraction of it.
        iterations
            Limit.
        """
        shape = self.domain_shape if like is None else like.shape
        v = torch.randn(shape, generator=torch.Generator().manual_seed(0))
        v = v if like is None else v.to(like)
        norm = 0.0
        for _ in range(iterations):
            v = self.adjoint(self(v / torch.linalg.vector_norm(v).clamp_min(1e-30)))
            before, norm = norm, math.sqrt(float(torch.linalg.vector_norm(v)))
            if norm - before <= tolerance * norm:
                break
        return norm

    @overload
    def __matmul__(self, other: "LinearOperator") -> "LinearOperator": ...

    @overload
    def __matmul__(self, other: Tensor) -> Tensor: ...

    def __matmul__(self, other: "LinearOperator | Tensor") -> "LinearOperator | Tensor":
        if isinstance(other, Tensor):
            return self(other)
        return Composition(self, other) if isinstance(other, LinearOperator) else NotImplemented

    def __add__(self, other: "LinearOperator") -> "LinearOperator":
        return Sum(self, other) if isinstance(other, LinearOperator) else NotImplemented

    def __sub__(self, other: "LinearOperator") -> "LinearOperator":
        return self + -other if isinstance(other, LinearOperator) else NotImplemented

    def __neg__(self) -> "LinearOperator":
        return -1.0 * self

    def __mul__(self, factor: float) -> "LinearOperator":
        return Multiple(float(factor), self)

    __rmul__ = __mul__


class Adjoint(LinearOperator):
    """A*; ``A.H.H`` is A.

    Parameters
    ----------
    operator
        A.
    """

    def __init__(self, operator: LinearOperator) -> None:
        self.operator = operator

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """That of the range of A."""
        return self.operator.range_shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """That of the domain of A."""
        return self.operator.domain_shape

    @property
    def H(self) -> LinearOperator:  # noqa: N802
        """A."""
        return self.operator

    def _forward(self, v: Tensor) -> Tensor:
        return self.operator._adjoint(v)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self.operator._forward(y)


class Composition(LinearOperator):
    """A B: B first. One may have more leading axes than the other, which takes them as a batch.

    Parameters
    ----------
    outer, inner
        A and B.

    Raises
    ------
    ValueError
        If B does not give what A takes.
    """

    def __init__(self, outer: LinearOperator, inner: LinearOperator) -> None:
        self.outer, self.inner = outer, inner
        leads = _leads(outer.domain_shape, inner.range_shape)
        if leads is None:
            raise ValueError(
                f"{type(outer).__name__} takes tensors that end in {outer.domain_shape}, and "
                f"{type(inner).__name__} gives {inner.range_shape}: A @ B applies B first"
            )
        self._shapes = (*leads[0], *inner.domain_shape), (*leads[1], *outer.range_shape)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """That of B."""
        return self._shapes[0]

    @property
    def range_shape(self) -> tuple[int, ...]:
        """That of A."""
        return self._shapes[1]

    def _forward(self, v: Tensor) -> Tensor:
        return self.outer._forward(self.inner._forward(v))

    def _adjoint(self, y: Tensor) -> Tensor:
        return self.inner._adjoint(self.outer._adjoint(y))


class Sum(LinearOperator):
    """A + B.

    Parameters
    ----------
    first, second
        A and B; the one with fewer axes takes the others as a batch.

    Raises
    ------
    ValueError
        If they take or give different shapes.
    """

    def __init__(self, first: LinearOperator, second: LinearOperator) -> None:
        self.first, self.second = first, second
        domains = _leads(first.domain_shape, second.domain_shape)
        if domains is None or domains != _leads(first.range_shape, second.range_shape):
            raise ValueError(
                f"a sum of operators from {first.domain_shape} to {first.range_shape} and from "
                f"{second.domain_shape} to {second.range_shape}: both must be the same"
            )
        self._larger = first if domains[0] else second

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """That of both."""
        return self._larger.domain_shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """That of both."""
        return self._larger.range_shape

    def _forward(self, v: Tensor) -> Tensor:
        return self.first._forward(v) + self.second._forward(v)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self.first._adjoint(y) + self.second._adjoint(y)


class Multiple(LinearOperator):
    """A number times A.

    Parameters
    ----------
    factor, operator
        The number and A.
    """

    def __init__(self, factor: float, operator: LinearOperator) -> None:
        self.factor, self.operator = factor, operator

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """That of A."""
        return self.operator.domain_shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """That of A."""
        return self.operator.range_shape

    def _forward(self, v: Tensor) -> Tensor:
        return self.factor * self.operator._forward(v)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self.factor * self.operator._adjoint(y)


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
    if not v.requires_grad:  # A node costs more than an operator on few pixels.
        return operator._adjoint(v) if adjoint else operator._forward(v)
    out: Tensor = _Apply.apply(v, operator, adjoint)  # type: ignore[no-untyped-call]
    return out


def _leads(
    first: tuple[int, ...], second: tuple[int, ...]
) -> tuple[tuple[int, ...], tuple[int, ...]] | None:
    """Axes that each has in front of those in common; None where those differ."""
    common = min(len(first), len(second))
    if first[len(first) - common :] != second[len(second) - common :]:
        return None
    return first[: len(first) - common], second[: len(second) - common]


def _check_shape(tensor: Tensor, shape: tuple[int, ...], name: str) -> None:
    if tuple(tensor.shape[-len(shape) :]) != shape:
        raise ValueError(
            f"{name} takes tensors that end in {shape}, and got one of {tuple(tensor.shape)}"
        )
