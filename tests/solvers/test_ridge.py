"""The ridge regulariser: what it says of itself holds, and it learns."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.optimize import minimize

from nolens.errors import DataError, OptionError
from nolens.kernels import odd_spline_
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Gaussian, NonNegative, Poisson, proximal_gradient, split_admm
from nolens.solvers.ridge import (
    MODULUS,
    FilterBank,
    RidgeRegulariser,
    RidgeWeights,
    filter_norm,
    opponents,
)
from nolens.training.patches import PicturePool
from nolens.training.ridge import RidgeSchedule, RidgeTrainer


def some_weights(count: int = 6) -> RidgeWeights:
    """Random ones; potentials that are as far from convex as they may be."""
    generator = torch.Generator().manual_seed(3)

    def noise(*shape: int) -> np.ndarray:
        return torch.randn(shape, generator=generator).numpy()

    weights = RidgeWeights.from_arrays(
        {
            "bases": noise(2, 3, 3, 3),
            "filters": noise(count, 2, 3, 3),
            "knots": noise(count, 4) - 1,
            "bends": 3 * noise(count, 4) - 3,
            "trends": 0.3 * noise(count, 2),
        }
    )
    norm = filter_norm(weights.bases, weights.filters)
    return replace(weights, filters=weights.filters / norm)


WEIGHTS = some_weights()


def scene(*shape: int, seed: int = 0) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("shape", [(3, 9, 7), (2, 6, 8), (7, 70)])
def test_gradient(shape):
    """By torch, and by finite differences; its Lipschitz constant holds."""
    ridge = RidgeRegulariser(WEIGHTS, 0.1)
    v, step = scene(*shape), torch.randn(shape, dtype=torch.float64)
    at = v.clone().requires_grad_()
    (expected,) = torch.autograd.grad(ridge(at), at)
    torch.testing.assert_close(ridge.gradient(v), expected)
    rise = float(ridge(v + 1e-6 * step) - ridge(v - 1e-6 * step)) / 2e-6
    assert rise == pytest.approx(float((ridge.gradient(v) * step).sum()), rel=1e-5)
    w = v + 0.1 * step
    apart = (ridge.gradient(v) - ridge.gradient(w)).norm()
    assert float(apart) <= ridge.lipschitz * float((v - w).norm())
    # Rows are taken some at a time, and in float32 by another kernel.
    torch.testing.assert_close(ridge.gradient(v.float()).double(), expected, rtol=1e-3, atol=1e-4)


def test_proximal_map():
    """No minimiser finds less. With c = step · concavity, it takes no two points further apart than
    1/(1 − c) times: it is that of a function which, with c/2‖·‖² more, is convex.
    """
    v, step = scene(3, 5, 6), 0.7
    for non_negative in (False, True):
        ridge = RidgeRegulariser(
            WEIGHTS, 0.2, non_negative=non_negative, iterations=5000, tolerance=1e-10
        )
        shifted = v - 0.5

        def value(x, ridge=ridge, shifted=shifted):
            at = torch.from_numpy(x).reshape(shifted.shape).requires_grad_()
            total = RidgeRegulariser(WEIGHTS, 0.2)(at) + (at - shifted).square().sum() / (2 * step)
            total.backward()
            return float(total.detach()), at.grad.numpy().ravel()

        x = ridge.prox(shifted, step)
        found = minimize(
            value,
            shifted.clamp_min(0).numpy().ravel(),
            jac=True,
            method="L-BFGS-B",
            bounds=[(0 if non_negative else None, None)] * x.numel(),
            options={"ftol": 1e-14, "gtol": 1e-10, "maxiter": 2000},
        )
        assert value(x.numpy().ravel())[0] <= found.fun + 1e-9
        np.testing.assert_allclose(x.numpy().ravel(), found.x, atol=1e-4)
        assert float(ridge(x)) < math.inf
        slack = step * ridge.concavity
        for seed in range(3):
            other = scene(3, 5, 6, seed=seed) - 0.5
            apart = x - ridge.prox(other, step)
            product = float((apart * (shifted - other)).sum())
            assert (1 - slack) * float(apart.square().sum()) <= product + 1e-9
    assert float(ridge(v - 0.5)) == math.inf
    with pytest.raises(TypeError, match="no gradient"):
        ridge.gradient(v)


def test_it_is_nearly_convex():
    """½‖v‖² + R(v) on lines, for the strongest noise and the weakest."""
    places = torch.linspace(-3, 3, 101, dtype=torch.float64)
    for level in (0.01, 0.1, 0.5):
        ridge = RidgeRegulariser(WEIGHTS, level)
        for seed in range(5):
            generator = torch.Generator().manual_seed(seed)
            v, way = torch.randn((2, 3, 6, 6), generator=generator, dtype=torch.float64) * level
            line = [v + place * way for place in places]
            values = torch.stack([ridge(x) + 0.5 * x.square().sum() for x in line])
            assert float(values.diff().diff().min()) > 0


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_gradient_on_cuda():
    """In float32 as on the CPU: cuDNN's rounding to ten bits would be seen."""
    v = scene(3, 40, 50).float()
    ridge = RidgeRegulariser(WEIGHTS, 0.1)
    here, there = ridge.gradient(v), ridge.gradient(v.cuda()).cpu()
    assert float((there - here).norm()) < 1e-5 * float(here.norm())


def test_units_do_not_matter():
    v = scene(3, 8, 9)
    one, other = RidgeRegulariser(WEIGHTS, 0.1), RidgeRegulariser(WEIGHTS, 30.0, white=300.0)
    assert float(other(300 * v)) == pytest.approx(300**2 * float(one(v)))
    torch.testing.assert_close(other.prox(300 * v, 1.0), 300 * one.prox(v, 1.0))


def test_uniform_pictures_cost_nothing():
    ridge = RidgeRegulariser(WEIGHTS, 0.01)
    tints = torch.tensor([0.2, 0.9, 0.4]).double()[:, None, None].expand(3, 7, 8)
    assert float(ridge(tints)) == pytest.approx(0, abs=1e-12)
    assert float(ridge(tints[:2])) == pytest.approx(0, abs=1e-12)
    assert float(ridge(scene(3, 7, 8))) > 1e-4
    # Channels of others than three are regularised one by one, as mean of the colours.
    v = scene(2, 7, 8)
    assert float(ridge(v)) == pytest.approx(float(ridge(v[0]) + ridge(v[1])))
    assert opponents() @ opponents().T == pytest.approx(np.eye(3), abs=1e-12)


def test_filters():
    """The adjoint is one; the bound of the norm holds, and is not far above it."""
    bases, filters = WEIGHTS.bases.double(), WEIGHTS.filters.double()
    bank = FilterBank(bases, filters)
    v = torch.randn(1, 3, 14, 11, dtype=torch.float64)
    answers = bank(v)
    other = torch.randn_like(answers)
    assert float((answers * other).sum()) == pytest.approx(float((v * bank.adjoint(other)).sum()))
    norm = filter_norm(bases, filters)
    assert norm == pytest.approx(1, abs=1e-6)
    inner = torch.randn(1, 3, 24, 24, dtype=torch.float64)
    for _ in range(100):
        padded = torch.nn.functional.pad(inner, [2 * bank.reach] * 4)
        inner = bank.within_adjoint(bank.within(padded))[
            ..., 2 * bank.reach : -2 * bank.reach, 2 * bank.reach : -2 * bank.reach
        ]
        size = float(inner.norm())
        inner /= size
    assert 0.9 < math.sqrt(size) <= norm


def test_spline_kernel():
    """The compiled pass against torch's operations, for several pictures with their own knots."""
    t = torch.randn(2, 5, 40, 30).to(memory_format=torch.channels_last) * 3
    knots = torch.rand(3, 2, 5, 1, 1).cumsum(0)
    masses = torch.randn(3, 1, 5, 1, 1)
    expected = odd_spline_(t.double(), knots.double(), masses.double())
    torch.testing.assert_close(odd_spline_(t.clone(), knots, masses).double(), expected)


@pytest.mark.parametrize("noise", ["gaussian", "poisson"])
def test_measurements(noise):
    """Solvers agree on the scene, and end below where they start."""
    psf = torch.rand(1, 20, 20, generator=torch.Generator().manual_seed(1)).double() ** 8
    operator = CroppedConvolution(psf / psf.sum(), (20, 20), PixelRectangle(4, 4, 12, 12))
    truth = torch.zeros(1, 12, 12, dtype=torch.float64)
    truth[:, 3:8, 4:9] = 1.0
    if noise == "gaussian":
        b = operator(truth) + 0.01 * torch.randn(1, 20, 20, dtype=torch.float64)
        data = Gaussian(b, weights=torch.full_like(b, 1e4)) @ operator
    else:
        data = Poisson(torch.poisson(500 * operator(truth) + 1), background=1.0) @ (500 * operator)
    ridge = 20.0 * RidgeRegulariser(WEIGHTS, 0.1)
    start = 0.1 * torch.ones_like(truth)
    results = [
        solver(data, ridge, NonNegative(), start=start, iterations=600, tolerance=1e-5)
        for solver in (split_admm, proximal_gradient)
    ]
    begun = float(data(start) + ridge(start))
    assert all(each.objective < 0.9 * begun for each in results)
    assert results[0].objective == pytest.approx(results[1].objective, rel=0.02)


SCHEDULE = RidgeSchedule(8, rate=2e-2, patches=2, side=16)


@pytest.fixture(scope="module")
def pool() -> PicturePool:
    return PicturePool.generate(2, 5)


def test_training_learns(pool):
    """The loss on one batch falls; the same seed gives the same weights, also of a resumed run."""
    trainers = [RidgeTrainer(SCHEDULE, seed=1) for _ in range(2)]
    before = trainers[0].loss(pool)
    for _ in range(6):
        trainers[0].learn(pool)
    after = trainers[0].step
    trainers[0].step = 0
    assert trainers[0].loss(pool) < 0.9 * before
    trainers[0].step = after
    for _ in range(3):
        trainers[1].learn(pool)
    resumed = RidgeTrainer(SCHEDULE, seed=9)
    resumed.resume(trainers[1].state())
    for _ in range(3):
        resumed.learn(pool)
    expected = trainers[0].trained().arrays()
    for name, value in resumed.trained().arrays().items():
        np.testing.assert_array_equal(value, expected[name])


def test_weights_as_half_floats():
    arrays = {name: each.astype(np.float16) for name, each in WEIGHTS.arrays().items()}
    rounded = RidgeWeights.from_arrays(arrays)
    assert rounded.norm == pytest.approx(WEIGHTS.norm, rel=1e-3)
    v = scene(3, 8, 9)
    one, other = (RidgeRegulariser(each, 0.1) for each in (WEIGHTS, rounded))
    assert float(one(v)) == pytest.approx(float(other(v)), rel=0.01)
    assert float(other(torch.ones(3, 7, 7))) == pytest.approx(0, abs=1e-12)


def test_weights_that_cannot_be_used():
    arrays = WEIGHTS.arrays()
    for change, words in (
        ({"knots": arrays["knots"][:, :2]}, "have the shapes"),
        ({"bases": arrays["bases"] * math.nan}, "NaN"),
    ):
        with pytest.raises(DataError, match=words):
            RidgeWeights.from_arrays({**arrays, **change})
    with pytest.raises(DataError, match="lack bases"):
        RidgeWeights.from_arrays({k: v for k, v in arrays.items() if k != "bases"})
    for sigma, white in ((0.0, 1.0), (math.nan, 1.0), (0.1, -1.0)):
        with pytest.raises(OptionError, match="must be above 0"):
            RidgeRegulariser(WEIGHTS, sigma, white=white)
    with pytest.raises(DataError, match="at least"):
        RidgeRegulariser(WEIGHTS, 0.1)(torch.ones(3, 1, 9))


def test_concavity_grows_with_the_weight():
    ridge = RidgeRegulariser(WEIGHTS, 0.1)
    assert 0 < ridge.concavity <= 1.1 * MODULUS
    assert (3.0 * ridge).concavity == pytest.approx(3 * ridge.concavity)
    assert NonNegative().concavity == 0
