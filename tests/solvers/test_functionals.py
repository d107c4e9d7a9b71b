"""Every functional, through one suite: its proximal map is the one of its value, and no other."""

import importlib
import math
import pkgutil
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import torch
from scipy.optimize import lsq_linear, minimize
from torch import Tensor

import nolens.solvers
from nolens.errors import DataError, OptionError
from nolens.operators import Diagonal, LinearOperator
from nolens.solvers import (
    L1,
    Box,
    Denoiser,
    Functional,
    Gaussian,
    GroupSparsity,
    NonNegative,
    OpponentL1,
    Poisson,
    Ridge,
    Support,
    TotalVariation,
)
from nolens.solvers.functionals import Weighted
from nolens.solvers.ridge import RidgeRegulariser

SHAPE = (2, 2, 3)
MASK = torch.arange(12).reshape(SHAPE) % 3 > 0
WEIGHTS = torch.linspace(0.5, 2, 12).double().reshape(SHAPE)
COUNTS = torch.tensor([0, 1, 2, 5, 0, 9, 1, 1, 3, 0, 4, 2]).double().reshape(SHAPE)
VARIATION = TotalVariation(SHAPE, border="free")


@dataclass(frozen=True)
class Case:
    """A functional with its conjugate, by hand: a value where |p| is feasible, else infinite.

    `off` is what an iterative proximal map may miss in values.
    """

    functional: Functional
    conjugate: Callable[[Tensor], Tensor | float]
    off: float = 0.0

    @property
    def name(self) -> str:
        return type(self.functional).__name__


def where(feasible: Tensor, value: Tensor | float = 0.0) -> Tensor:
    """The value where all is feasible, but for rounding; else infinite."""
    return torch.as_tensor(value) if bool(feasible.all()) else torch.tensor(math.inf)


def of_poisson(p: Tensor) -> Tensor:
    w = WEIGHTS * MASK
    inside = torch.where(MASK, p <= w + 1e-9, p.abs() < 1e-9)
    q = torch.where(MASK, (1 - p / w).clamp_min(1e-300), 1.0)
    return where(inside, -(0.3 * p * MASK).sum() - (w * COUNTS * q.log()).sum())


def of_opponents(p: Tensor) -> Tensor:
    red, green, blue = p.unbind(-1)
    mean, colour = (red + green + blue) / 3**0.5, (red - blue) / 2**0.5
    other = (red + blue - 2 * green) / 6**0.5
    return where(
        (mean.abs() <= 0.5 + 1e-9) & (torch.maximum(colour.abs(), other.abs()) <= 2 + 1e-9)
    )


def of_variation(p: Tensor) -> Tensor:
    """Feasible is K*q with |q| ≤ 1."""
    matrix = dense(VARIATION.operator)
    found = [
        lsq_linear(matrix.T, channel, bounds=(-1, 1), method="bvls")
        for channel in p.flatten(1).numpy()
    ]
    return where(torch.tensor([2 * each.cost for each in found]) < 1e-18)


def dense(operator: LinearOperator) -> np.ndarray:
    size = math.prod(operator.domain_shape)
    one = torch.eye(size, dtype=torch.float64).reshape(size, *operator.domain_shape)
    matrix: np.ndarray = operator(one).reshape(size, -1).T.numpy()
    return matrix


CASES = [
    Case(NonNegative(), lambda p: where(p <= 1e-9)),
    Case(Box(-0.5, WEIGHTS), lambda p: torch.maximum(-0.5 * p, WEIGHTS * p).sum()),
    Case(Support(MASK), lambda p: where((p * MASK).abs() < 1e-9)),
    Case(0.7 * L1(), lambda p: where(p.abs() <= 0.7 + 1e-9)),
    Case(GroupSparsity(-3), lambda p: where(torch.linalg.vector_norm(p, dim=-3) <= 1 + 1e-9)),
    Case(OpponentL1(-1, mean=0.5, colour=2.0), of_opponents),
    Case(2.0 * Ridge(), lambda p: p.square().sum() / 4),
    Case(
        Gaussian(COUNTS, weights=WEIGHTS, valid=MASK),
        lambda p: where(
            (p * ~MASK).abs() < 1e-9,
            (p * COUNTS + p.square() / (2 * WEIGHTS)).mul(MASK).sum(),
        ),
    ),
    Case(Poisson(COUNTS, background=0.3, weights=WEIGHTS, valid=MASK), of_poisson),
    Case(VARIATION, of_variation, 3e-5),
]
ELSEWHERE = {
    Denoiser: "has no value (test_plug_and_play.py)",
    RidgeRegulariser: "is not convex (test_ridge.py)",
}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_proximal_map(case):
    """Fenchel and Young: f(x) + f*(p) = ⟨x, p⟩ where p is a subgradient of f at x, and only there.

    p = (v − x)/s is one at the proximal map x of f, and that of f* is one by Moreau's identity.
    Neither map takes two points further apart than ⟨Pv − Pw, v − w⟩ (firmly non-expansive).
    """
    f, conjugate = case.functional, case.conjugate
    for step in (0.2, 1.0, 30.0):
        v = 3 * torch.randn(SHAPE, dtype=torch.float64)
        x, p = f.prox(v, step), f.conjugate_prox(v, step)
        for one, other in ((x, (v - x) / step), (f.prox(v / step, 1 / step), p)):
            value, dual = float(f(one)), float(conjugate(other))
            product = float((one * other).sum())
            most = (case.off + 1e-8) * (1 + abs(product))
            assert value + dual == pytest.approx(product, abs=most)
    for apply in (f.prox, f.conjugate_prox):
        points = [(v, apply(v, 0.8)) for v in 2 * torch.randn((6, *SHAPE), dtype=torch.float64)]
        for v, x in points:
            for w, y in points:
                apart, along = (x - y).square().sum(), ((x - y) * (v - w)).sum()
                assert float(apart) <= float(along) + case.off + 1e-12


def test_every_functional_is_in_the_suite():
    package = nolens.solvers
    for module in pkgutil.iter_modules(package.__path__, f"{package.__name__}."):
        importlib.import_module(module.name)
    known, todo = set(), [Functional]
    while todo:
        found = [c for c in todo.pop().__subclasses__() if c.__module__.startswith("nolens.")]
        known.update(found)
        todo.extend(found)
    tried: set[type] = set()
    for functional in (case.functional for case in CASES):
        weighed = functional.functional if isinstance(functional, Weighted) else functional
        tried.update(type(functional).__mro__, type(weighed).__mro__)
    own = {c for c in known if not c.__abstractmethods__ and not c.__name__.startswith("_")}
    assert own - tried == set(ELSEWHERE)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_no_minimiser_finds_less(case):
    """Nelder and Mead's, from the proximal map and from v."""
    f, v, step = case.functional, torch.randn(SHAPE, dtype=torch.float64), 0.6
    free = [1, 6, 7]  # Group 1, 7; pixel 6 is not valid.

    def value(at: np.ndarray) -> float:
        x = best.clone()
        x.view(-1)[free] = torch.from_numpy(at)
        return min(float(f(x) + (x - v).square().sum() / (2 * step)), 1e9)

    best = f.prox(v, step)
    least = value(best.view(-1)[free].numpy())
    for start in (best, v):
        found = minimize(
            value, start.view(-1)[free].numpy(), method="Nelder-Mead", options={"xatol": 1e-9}
        )
        assert found.fun >= least - case.off - 1e-10
        if value(start.view(-1)[free].numpy()) < 1e9:
            assert found.fun == pytest.approx(least, abs=1e-5)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_gradient(case):
    """That of the value, by torch; its Lipschitz constant holds; quadratic ones say so."""
    f = case.functional
    if f.lipschitz is None:
        with pytest.raises(TypeError, match="has no gradient"):
            f.gradient(COUNTS)
        return
    v = (COUNTS + 0.5).requires_grad_()
    (expected,) = torch.autograd.grad(f(v), v)
    torch.testing.assert_close(f.gradient(v.detach()), expected)
    w = v.detach() * 0.3
    apart = (f.gradient(v.detach()) - f.gradient(w)).norm()
    assert float(apart) <= f.lipschitz * float((v.detach() - w).norm())
    if f.hessian is not None:
        step = w.sin()
        parabola = f(w) + (step * f.gradient(w) + 0.5 * f.hessian * step.square()).sum()
        assert float(f(w + step)) == pytest.approx(float(parabola))


@pytest.mark.parametrize("border", ["zero", "periodic", "free"])
def test_total_variation(border):
    """Value by hand; proximal map against scipy: x = v − sK*p with |p| ≤ 1 nearest to zero."""
    v = torch.tensor([[1.0, 4.0, 9.0], [0.0, 2.0, 5.0]], dtype=torch.float64)
    inside = 3 + 5 + 2 + 3 + 1 + 2 + 4
    beside = {"zero": 1 + 9 + 0 + 5 + 1 + 4 + 9 + 0 + 2 + 5, "periodic": 8 + 5 + 7, "free": 0}
    variation = TotalVariation((3, 2, 3), border=border)
    assert float(variation(v)) == inside + beside[border]
    step = 0.8
    matrix = dense(variation.operator)
    found = lsq_linear(step * matrix.T, v.numpy().ravel(), bounds=(-1, 1), tol=1e-14)
    expected = v.numpy().ravel() - step * matrix.T @ found.x
    x = (0.5 * variation).prox(v, 2 * step).numpy().ravel()
    np.testing.assert_allclose(x, expected, rtol=0, atol=1e-5)


def test_isotropic_total_variation():
    v = torch.tensor([[1.0, 4.0], [0.0, 2.0]], dtype=torch.float64)
    variation = TotalVariation((2, 2), isotropic=True, border="free")
    assert float(variation(v)) == pytest.approx(math.hypot(1, 3) + 2 + 2)
    matrix, step = dense(variation.operator), 0.5

    def smooth(x: np.ndarray) -> float:
        lengths = np.sqrt((matrix @ x).reshape(2, -1) ** 2 + 1e-14).T
        return float(np.hypot(*lengths.T).sum() + ((x - v.numpy().ravel()) ** 2).sum() / (2 * step))

    found = minimize(smooth, v.numpy().ravel(), method="BFGS", options={"gtol": 1e-9})
    np.testing.assert_allclose(variation.prox(v, step).numpy().ravel(), found.x, atol=1e-4)


def test_poisson_without_background_is_kullback_leibler():
    counts = torch.tensor([0.0, 3.0])
    assert float(Poisson(counts)(torch.tensor([0.5, 1.5]))) == pytest.approx(3 * math.log(2) - 1)
    assert float(Poisson(counts)(torch.tensor([-0.5, 1.5]))) == math.inf
    assert float(Poisson(counts)(torch.tensor([0.0, 0.0]))) == math.inf
    assert Poisson(counts).lipschitz == math.inf
    # Very dark in float32, where a difference of roots would be zero.
    x = Poisson(counts).prox(torch.tensor([-1e5, -1e5]), 1.0)
    torch.testing.assert_close(x, torch.tensor([0.0, 3e-5]), rtol=1e-4, atol=0)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Gaussian(COUNTS, valid=MASK[:, :1, :2]), ["(2, 2, 3)", "(2, 1, 2)"]),
        (lambda: Gaussian(COUNTS.long()), ["int64", "give floating point data"]),
        (lambda: Gaussian(COUNTS.log()), ["NaN or infinity", "as not valid"]),
        (lambda: Gaussian(COUNTS, weights=-WEIGHTS), ["a weight is negative"]),
        (lambda: Poisson(COUNTS - 1), ["the least count is -1"]),
        (lambda: Poisson(COUNTS, background=-2.0), ["the least background -2"]),
        (lambda: Gaussian(COUNTS[..., :2]) @ Diagonal(WEIGHTS), ["(2, 2, 2)", "(2, 2, 3)"]),
        (lambda: 2.0 * Poisson(COUNTS[:, 1:]) @ Diagonal(WEIGHTS), ["(2, 1, 3)", "(2, 2, 3)"]),
    ],
)
def test_data_that_cannot_be_used(make, words):
    with pytest.raises(DataError) as caught:
        make()
    assert all(word in str(caught.value) for word in words)
    # What is not valid may be anything.
    assert float(Gaussian(COUNTS.log(), valid=COUNTS > 0)(COUNTS)) > 0


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: -1.0 * L1(), "weight of a functional is -1.0"),
        (lambda: Box(1, 0), "from 1 to 0: give a lower bound"),
        (lambda: Box(0.5 * WEIGHTS, math.nan), "from a tensor (2, 2, 3) to nan"),
        (lambda: TotalVariation((5,)), "the shape is (5,), axes 2"),
        (lambda: TotalVariation((5, 4), border="mirror"), "'zero', 'periodic' or 'free'"),
    ],
)
def test_functionals_that_cannot_be(make, words):
    with pytest.raises(OptionError) as caught:
        make()
    assert words in str(caught.value)


def test_composition():
    """Weights and operators in any order are one functional of one operator."""
    scale = Diagonal(WEIGHTS)
    v = torch.randn(SHAPE, dtype=torch.float64)
    for f in (
        0.5 * (L1() @ scale),
        (0.5 * L1()) @ scale,
        (0.5 * (0.2 * L1() @ scale)) @ (5 * scale),
    ):
        inner, operator = f.parts
        assert operator is not None
        assert float(inner(operator(v))) == pytest.approx(float(f(v)))
    # Of a diagonal it is soft thresholding by each pixel's weight.
    weighted = (L1() @ scale).prox(v, 0.4)
    expected = v - v.clamp(-0.4 * WEIGHTS, 0.4 * WEIGHTS)
    torch.testing.assert_close(weighted, expected, rtol=0, atol=1e-5)
