"""Convex functionals with proximal maps: what is assumed of a scene."""

import math
from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Literal, NamedTuple, Self

import torch
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.kernels import OPPONENTS
from nolens.operators import Crop, Diagonal, FiniteDifference, LinearOperator

_PIXELS = 65_536
"""Of a part, about: as many as stay in the cache."""
_SAFETY = 1.01
"""Factor on a norm that power iteration gives from below."""


class Functional(ABC):
    r"""A function f of a scene, with its proximal map (`parikh2014`); convex, or nearly so.

    Subclasses write `_value` and `prox`, smooth ones `gradient` and `lipschitz`.
    ``0.01 * f`` is f with a weight, ``f @ A`` is v ↦ f(Av).
    """

    lipschitz: float | None = None
    """Lipschitz constant of the gradient; infinite without a bound, None without a gradient."""
    separable = False
    """Whether it is a sum over pixels."""
    keeps_penalty = False
    """Whether the solution depends on the step of the proximal map, as with a denoiser."""
    concavity: float = 0.0
    """Least c such that f(v) + ½c‖v‖² is convex: 0 of a convex f. The proximal map of others is the
    one minimiser for steps below 1/c."""

    @abstractmethod
    def _value(self, v: Tensor) -> Tensor: ...

    def __call__(self, v: Tensor) -> Tensor:
        """f(v) as a float64 number; infinite where v is not feasible."""
        return self._value(v)

    @abstractmethod
    def prox(self, v: Tensor, step: float) -> Tensor:
        r"""Argmin f(x) + ‖x − v‖² / (2 step) over x.

        Parameters
        ----------
        v
            Of any shape that f takes.
        step
            Above 0.
        """

    def gradient(self, v: Tensor) -> Tensor:
        """∇f(v), where `lipschitz` is not None."""
        raise TypeError(f"{type(self).__name__} has no gradient; use its prox")

    def conjugate_prox(self, v: Tensor, step: float) -> Tensor:
        r"""Proximal map of the conjugate f*, by Moreau's identity: v − s prox_{f/s}(v/s)."""
        return v - step * self.prox(v / step, 1 / step)

    @property
    def parts(self) -> "Term":
        """What a solver splits: f and K of f(Kv)."""
        return Term(self, None)

    @property
    def hessian(self) -> Tensor | float | None:
        """Weights w where f(v) is ½Σ w (v − b)², for solvers with a linear step; else None."""
        return None

    @property
    def data(self) -> Tensor | None:
        """The measurement, of data terms; else None."""
        return None

    @property
    def curvature(self) -> float:
        """About the second derivative near the measurement, for a first step; 0 of others."""
        return 0.0

    def __rmul__(self, weight: float) -> "Functional":
        return Weighted(weight, self)

    def __matmul__(self, operator: LinearOperator) -> "Functional":
        return Composed(self, operator)


class Term(NamedTuple):
    """f(Kv), as solvers see it; K is None for the identity."""

    functional: Functional
    operator: LinearOperator | None

    def image(self, v: Tensor) -> Tensor:
        """Kv."""
        return v if self.operator is None else self.operator(v)

    def back(self, y: Tensor) -> Tensor:
        """K*y."""
        return y if self.operator is None else self.operator.adjoint(y)

    def squared_norm(self, like: Tensor) -> float:
        """‖K‖², rather too large than too small."""
        return 1.0 if self.operator is None else (_SAFETY * self.operator.norm(like)) ** 2


class Weighted(Functional):
    """A number, 0 or more, times a functional.

    Parameters
    ----------
    weight, functional
        The number and the functional.

    Raises
    ------
    OptionError
        If the weight is negative or not finite.
    """

    def __init__(self, weight: float, functional: Functional) -> None:
        if not 0 <= weight < math.inf:
            raise OptionError(f"the weight of a functional is {weight}; it must be 0 or more")
        self.weight, self.functional = float(weight), functional
        self.separable, self.keeps_penalty = functional.separable, functional.keeps_penalty
        self.concavity = self.weight * functional.concavity
        bound = functional.lipschitz
        self.lipschitz = None if bound is None else self.weight * bound if weight > 0 else 0.0

    def _value(self, v: Tensor) -> Tensor:
        return self.weight * self.functional(v) if self.weight > 0 else _indicator(v, True)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """That of the functional with weight · step."""
        return self.functional.prox(v, self.weight * step) if self.weight > 0 else v

    def conjugate_prox(self, v: Tensor, step: float) -> Tensor:
        """Weight times that of the functional at v over the weight."""
        if self.weight == 0:
            return 0 * v
        return self.weight * self.functional.conjugate_prox(v / self.weight, step / self.weight)

    def gradient(self, v: Tensor) -> Tensor:
        """Weight times that of the functional."""
        return self.weight * self.functional.gradient(v) if self.weight > 0 else 0 * v

    @property
    def parts(self) -> Term:
        """The weight goes with f."""
        inner, operator = self.functional.parts
        return Term(self if operator is None else self.weight * inner, operator)

    @property
    def hessian(self) -> Tensor | float | None:
        """Weight times that of the functional."""
        inner = self.functional.hessian
        return None if inner is None else self.weight * inner

    @property
    def data(self) -> Tensor | None:
        """That of the functional."""
        return self.functional.data

    @property
    def curvature(self) -> float:
        """Weight times that of the functional."""
        return self.weight * self.functional.curvature


class Composed(Functional):
    """v ↦ f(Kv). Its proximal map is solved for in the dual (`ProximalSum`).

    Parameters
    ----------
    functional, operator
        f and K.

    Raises
    ------
    DataError
        If f is a data term, and its measurement has another shape than K gives.
    """

    def __init__(self, functional: Functional, operator: LinearOperator) -> None:
        inner, first = functional.parts
        self.functional = inner
        self.operator = operator if first is None else first @ operator
        if inner.data is not None:
            _check_shape(tuple(inner.data.shape), self.operator.range_shape)

    def _value(self, v: Tensor) -> Tensor:
        return self.functional(self.operator(v))

    def prox(self, v: Tensor, step: float) -> Tensor:
        """By up to 1000 iterations, until the result stands to a part in ten million."""
        return ProximalSum([self], iterations=1000, tolerance=1e-7)(v, step)

    @property
    def parts(self) -> Term:
        """The functional and the operator."""
        return Term(self.functional, self.operator)


class Box(Functional):
    """0 where lower ≤ v ≤ upper, else infinite.

    Parameters
    ----------
    lower, upper
        Numbers, or tensors that broadcast.

    Raises
    ------
    OptionError
        If the lower bound is above the upper one somewhere, or one is NaN.
    """

    def __init__(self, lower: Tensor | float, upper: Tensor | float) -> None:
        if not bool((torch.as_tensor(lower) <= torch.as_tensor(upper)).all()):
            raise OptionError(
                f"the box is from {_range(lower)} to {_range(upper)}: give a lower bound that is "
                "nowhere above the upper one"
            )
        self.lower, self.upper = lower, upper

    def _value(self, v: Tensor) -> Tensor:
        return _indicator(v, bool(((v >= self.lower) & (v <= self.upper)).all()))

    def prox(self, v: Tensor, step: float) -> Tensor:
        """The nearest v in the box."""
        lower, upper = (
            torch.as_tensor(each, dtype=v.dtype, device=v.device)
            for each in (self.lower, self.upper)
        )
        return v.clamp(lower, upper)


class NonNegative(Box):
    """0 where v ≥ 0, else infinite."""

    def __init__(self) -> None:
        super().__init__(0.0, math.inf)


class Support(Functional):
    """0 where v is zero outside a support, else infinite.

    Parameters
    ----------
    mask
        bool, True on the support; a shape that broadcasts.
    """

    def __init__(self, mask: Tensor) -> None:
        self.mask = mask

    def _value(self, v: Tensor) -> Tensor:
        return _indicator(v, not bool(torch.where(self.mask.to(v.device), 0, v).any()))

    def prox(self, v: Tensor, step: float) -> Tensor:
        """Zero outside the support."""
        return torch.where(self.mask.to(v.device), v, 0)


class L1(Functional):
    """‖v‖₁, for scenes of few bright points."""

    separable = True

    def _value(self, v: Tensor) -> Tensor:
        return v.abs().sum(dtype=torch.float64)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """Soft thresholding."""
        return v - v.clamp(-step, step)

    def conjugate_prox(self, v: Tensor, step: float) -> Tensor:
        """The nearest v between −1 and 1."""
        return v.clamp(-1, 1)


class GroupSparsity(Functional):
    """‖v‖₂,₁: the sum of the lengths of groups, such as the colours of a pixel (`yuan2006`).

    Parameters
    ----------
    axis
        Axes of a group, from the last: ``-3`` for the channels.
    """

    def __init__(self, axis: int | tuple[int, ...]) -> None:
        self.axis = axis

    def _value(self, v: Tensor) -> Tensor:
        return lengths(v, self.axis).sum(dtype=torch.float64)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """Every group, shorter by the step."""
        return v * (1 - step / lengths(v, self.axis).clamp_min(step))

    def conjugate_prox(self, v: Tensor, step: float) -> Tensor:
        """Every group, no longer than 1."""
        return v / lengths(v, self.axis).clamp_min(1)


class OpponentL1(Functional):
    r"""ℓ1 norm of opponent colours: their mean, red against blue, green against both.

    .. math:: \sum_k g_k ‖(Tv)_k‖_1, \qquad T = \begin{pmatrix} 1/\sqrt3 & 1/\sqrt3 & 1/\sqrt3 \\
       1/\sqrt2 & 0 & -1/\sqrt2 \\ 1/\sqrt6 & -2/\sqrt6 & 1/\sqrt6 \end{pmatrix}

    Of differences of neighbouring pixels it is a total variation that takes edges of all colours at
    one place for likelier than edges of one (`condat2012`, who weighs colours so in demosaicking).

    Parameters
    ----------
    axis
        Of the three colours, from the last.
    mean, colour
        :math:`g_0`, and :math:`g_1 = g_2`.
    """

    def __init__(self, axis: int, *, mean: float = 1.0, colour: float = 2.0) -> None:
        self.axis, self.mean, self.colour = axis, mean, colour

    @classmethod
    def of_scene(cls, axis: int) -> Self:
        """Of a scene's differences, beside the ℓ1 norm of each colour by itself (decision 18)."""
        return cls(axis, mean=0.8, colour=1.28)

    def _value(self, v: Tensor) -> Tensor:
        total = v.new_zeros((), dtype=torch.float64)
        for part in self._parts(v):
            sums = self._turned(part, OPPONENTS).abs_() * self._weights(v)
            total += sums.sum().double()
        return total

    def prox(self, v: Tensor, step: float) -> Tensor:
        """Soft thresholding of the opponent colours."""
        out = torch.empty_like(v)
        most = step * self._weights(v)
        for part, shrunk in zip(self._parts(v), self._parts(out), strict=True):
            opponents = self._turned(part, OPPONENTS)
            shrunk.copy_(self._turned(opponents - opponents.clamp(-most, most), OPPONENTS.T))
        return out

    def _parts(self, v: Tensor) -> tuple[Tensor, ...]:
        """One after the other: what is held between is several times as large."""
        axis, across = (-2, -1) if self.axis != -2 else (-1, -2)
        return torch.split(v, max(1, _PIXELS // max(1, v.shape[across])), axis)

    def _turned(self, v: Tensor, matrix: Tensor) -> Tensor:
        mixed: Tensor = torch.tensordot(matrix.to(v), v, dims=([1], [v.ndim + self.axis]))
        return mixed.movedim(0, self.axis)

    def _weights(self, v: Tensor) -> Tensor:
        weights = v.new_tensor([self.mean, self.colour, self.colour])
        return weights.view(3, *[1] * (-self.axis - 1))


class Ridge(Functional):
    """½‖v‖², Tikhonov's."""

    lipschitz = 1.0
    separable = True

    def _value(self, v: Tensor) -> Tensor:
        return 0.5 * v.square().sum(dtype=torch.float64)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """V / (1 + step)."""
        return v / (1 + step)

    def gradient(self, v: Tensor) -> Tensor:
        """V."""
        return v

    @property
    def hessian(self) -> float:
        """1."""
        return 1.0


class TotalVariation(Composed):
    r"""Σ|v[i+1, j] − v[i, j]| + |v[i, j+1] − v[i, j]|, or the lengths of such pairs.

    Parameters
    ----------
    shape
        Trailing axes of the scene, such as `LinearOperator.domain_shape`.
    isotropic
        Σ of the lengths √(Δ₀² + Δ₁²) (`rudin1992`), in place of the sum of both.
    border
        ``"zero"``: dark around the scene, as eq. 7 of `uvimprint` has it on a support.
        ``"periodic"``: the first pixel follows the last. ``"free"``: nothing follows it.
    axes
        How many of the last axes vary: 3 for a volume or a video.

    Raises
    ------
    OptionError
        If the scene has fewer axes, or the border is another.
    """

    def __init__(
        self,
        shape: Sequence[int],
        *,
        isotropic: bool = False,
        border: Literal["zero", "periodic", "free"] = "zero",
        axes: int = 2,
    ) -> None:
        sizes = tuple(shape)[-axes:]
        if border not in ("zero", "periodic", "free") or not 0 < axes == len(sizes):
            raise OptionError(
                f"the shape is {tuple(shape)}, axes {axes} and border {border!r}; give so many "
                "axes of the scene or more, and the border 'zero', 'periodic' or 'free'"
            )
        self.isotropic, self.border = isotropic, border
        operator: LinearOperator = FiniteDifference(sizes)
        if border == "zero":
            operator = padded_difference(sizes, tuple(size + 1 for size in sizes))
        if border == "free":
            follows = torch.ones(operator.range_shape, dtype=torch.bool)
            for axis in range(axes):
                follows[axis].select(axis, -1).fill_(False)
            operator = Diagonal(follows) @ operator
        super().__init__(GroupSparsity(-axes - 1) if isotropic else L1(), operator)


class ProximalSum:
    r"""argmin Σ fᵢ(Kᵢx) + ‖x − v‖² / (2 step) over x, by the dual (`beck2009tv`).

    One term without an operator keeps its own proximal map. Each of the others has a dual variable
    p of its own,

    .. math:: x = \operatorname{prox}_{sf_0}(v - s \sum_i K_i^* p_i), \qquad
       p_i \leftarrow \operatorname{prox}_{σ_i f_i^*}(p_i + σ_i K_i x), \qquad
       σ_i = \frac{1}{s m \|K_i\|^2}

    for m of them, with the momentum of FISTA. A call starts from the p of the call before.

    Parameters
    ----------
    functionals
        One or more.
    iterations, tolerance
        Limit; ends when ‖x − x_before‖ ≤ tolerance · ‖x‖.
    """

    def __init__(
        self, functionals: Sequence[Functional], *, iterations: int, tolerance: float = 0.0
    ) -> None:
        self._split = terms_of(functionals)
        self._plain = pop_plain(self._split)
        self._iterations, self._tolerance = iterations, tolerance
        self._norms: list[float] = []
        self._duals: list[Tensor] = []

    def __call__(self, v: Tensor, step: float) -> Tensor:
        """The proximal map at v."""
        if not self._split:
            return self._primal(v, step, [])
        if not self._duals:
            self._norms = [term.squared_norm(v) for term in self._split]
            self._duals = [torch.zeros_like(term.image(v)) for term in self._split]
        duals, momentum = self._duals, 1.0
        ahead = duals
        x = self._primal(v, step, ahead)
        for _ in range(self._iterations):
            before = duals
            duals = [
                term.functional.conjugate_prox(p + s * term.image(x), s)
                for term, p, s in zip(self._split, ahead, self._steps(step), strict=True)
            ]
            following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            factor, momentum = (momentum - 1) / following, following
            ahead = [p + factor * (p - b) for p, b in zip(duals, before, strict=True)]
            x_before, x = x, self._primal(v, step, ahead)
            if self._tolerance > 0 and length(x - x_before) <= self._tolerance * length(x):
                break
        self._duals = duals
        return self._primal(v, step, duals)

    def _steps(self, step: float) -> list[float]:
        return [1 / (step * len(self._split) * max(norm, 1e-30)) for norm in self._norms]

    def _primal(self, v: Tensor, step: float, duals: list[Tensor]) -> Tensor:
        for term, p in zip(self._split, duals, strict=True):
            v = v - step * term.back(p)
        return v if self._plain is None else self._plain.prox(v, step)


def padded_difference(sizes: tuple[int, ...], padded: tuple[int, ...]) -> LinearOperator:
    """Differences of a scene on a padded shape, periodic, with zeros around the scene."""
    return FiniteDifference(padded) @ Crop(padded, (*(0 for _ in sizes), *sizes)).H


def terms_of(functionals: Sequence[Functional]) -> list[Term]:
    """What solvers split: boxes, and the first sum over pixels without a gradient, as one term."""
    terms = [each.parts for each in functionals]
    plain = [t for t in terms if t.operator is None and t.functional.lipschitz is None]
    boxes = [term for term in plain if isinstance(term.functional, Box)]
    sums = [t for t in plain if t.functional.separable and not isinstance(t.functional, Box)][:1]
    merged = sums + boxes
    if len(merged) < 2:
        return terms
    rest = [term for term in terms if not any(term is each for each in merged)]
    return [*rest, Term(_Bounded([term.functional for term in merged]), None)]


def pop_plain(terms: list[Term]) -> Functional | None:
    """Take the last term without an operator from a list, where there is one."""
    for k, term in reversed(list(enumerate(terms))):
        if term.operator is None:
            return terms.pop(k).functional
    return None


class _Bounded(Functional):
    """A sum over pixels and boxes: a pixel's minimum in an interval is its minimum, clipped."""

    def __init__(self, functionals: Sequence[Functional]) -> None:
        self._functionals = functionals

    def _value(self, v: Tensor) -> Tensor:
        return torch.stack([each(v) for each in self._functionals]).sum()

    def prox(self, v: Tensor, step: float) -> Tensor:
        """That of each, boxes last."""
        for each in self._functionals:
            v = each.prox(v, step)
        return v


def lengths(v: Tensor, axis: int | tuple[int, ...]) -> Tensor:
    """Lengths along axes, which stay with size 1; fifty times as fast as torch's for two values."""
    return v.square().sum(dim=axis, keepdim=True).sqrt_()


def length(v: Tensor) -> float:
    """‖v‖."""
    return float(torch.linalg.vector_norm(v))


def _check_shape(measured: tuple[int, ...], product: tuple[int, ...]) -> None:
    """Refuse a measurement whose last axes are others than an operator gives."""
    common = min(len(measured), len(product))
    if common and measured[-common:] != product[-common:]:
        raise DataError(
            f"the measurement is {measured}, and the operator gives {product} as the last axes: "
            "give a measurement of that shape, or the operator that it is of"
        )


def _range(bound: Tensor | float) -> str:
    """A bound as messages have it; of a tensor its shape."""
    if isinstance(bound, Tensor) and bound.numel() > 1:
        return f"a tensor {tuple(bound.shape)}"
    return f"{float(bound):g}"


def _indicator(v: Tensor, feasible: bool) -> Tensor:
    return v.new_tensor(0.0 if feasible else math.inf, dtype=torch.float64)
