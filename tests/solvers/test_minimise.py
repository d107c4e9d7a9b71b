"""The solvers of any objective: against scipy, dense solutions, and each other."""

import importlib
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from scipy.optimize import minimize, nnls
from torch import Tensor

from nolens.errors import DataError, DivergenceError, OptionError
from nolens.operators import (
    CroppedConvolution,
    Diagonal,
    FiniteDifference,
    HorizontalStack,
    LinearOperator,
    PixelRectangle,
    VerticalStack,
)
from nolens.solvers import (
    L1,
    Box,
    Denoiser,
    Functional,
    Gaussian,
    GroupSparsity,
    NonNegative,
    Poisson,
    Progress,
    Result,
    Ridge,
    Support,
    TotalVariation,
    minimise,
    primal_dual,
    proximal_gradient,
    split_admm,
)

SENSOR, SUPPORT = (6, 7), PixelRectangle(1, 1, 4, 5)
FRONT = importlib.import_module("nolens.solvers.minimise")
SOLVERS = [split_admm, primal_dual, proximal_gradient]
Solve = Callable[..., Result]


def test_penalties_that_are_far_too_small_grow() -> None:
    """Until the ℓ1 norm no longer takes all of the scene at each step: soft thresholding."""
    b = torch.linspace(0, 1, 11).double()[None, None]
    result = split_admm(
        Gaussian(b), 0.1 * L1(), NonNegative(), penalties=[1e-5], iterations=200, tolerance=1e-6
    )
    torch.testing.assert_close(result.scene, (b - 0.1).clamp_min(0), rtol=0, atol=1e-6)


def convolution(
    dtype: torch.dtype = torch.float64,
    seed: int = 1,
    support: PixelRectangle | None = SUPPORT,
    device: str = "cpu",
) -> CroppedConvolution:
    psf = torch.rand((1, *SENSOR), generator=torch.Generator().manual_seed(seed)) ** 8
    return CroppedConvolution(psf.to(device, dtype), SENSOR, support)


def scene_of(*shape: int) -> Tensor:
    scene = torch.zeros((*shape, 4, 5), dtype=torch.float64)
    scene[..., 1:3, 1:4] = 1
    scene[..., 0, 4] = 3
    return scene


def data_of(operator: LinearOperator, scene: Tensor, noise: float = 0.02) -> Tensor:
    data = operator(scene)
    return data + noise * data.abs().max() * torch.randn(data.shape, dtype=torch.float64)


def dense(operator: LinearOperator) -> np.ndarray:
    size = math.prod(operator.domain_shape)
    one = torch.eye(size, dtype=torch.float64).reshape(size, *operator.domain_shape)
    matrix: np.ndarray = operator(one).reshape(size, -1).T.numpy()
    return matrix


@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
def test_ridge_is_the_dense_solution(solve: Solve) -> None:
    """Nothing to split: (A*WA + λ) v = A*W b."""
    a = convolution()
    b, weights = data_of(a, scene_of(1)), torch.rand(SENSOR, dtype=torch.float64) + 0.5
    result = solve(Gaussian(b, weights=weights) @ a, 0.3 * Ridge(), tolerance=1e-9)
    matrix, w = dense(a), np.diag(weights.numpy().ravel())
    normal = matrix.T @ w @ matrix + 0.3 * np.eye(20)
    expected = np.linalg.solve(normal, matrix.T @ w @ b.numpy().ravel())
    np.testing.assert_allclose(result.scene.numpy().ravel(), expected, rtol=0, atol=1e-6)
    assert result.stop_reason == "converged"


@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
def test_non_negative_least_squares(solve: Solve) -> None:
    """With pixels that are not valid, of two measurements of one scene."""
    a = VerticalStack([convolution(), convolution(seed=2)])
    valid = torch.arange(2 * 42).reshape(2, *SENSOR) % 5 > 0
    b = data_of(a, scene_of(1), 0.1)
    data = Gaussian(torch.where(valid, b, math.nan), valid=valid) @ a
    result = solve(data, NonNegative(), tolerance=1e-8, iterations=4000)
    rows = valid.numpy().ravel()
    expected, _ = nnls(dense(a)[rows], b.numpy().ravel()[rows])
    np.testing.assert_allclose(result.scene.numpy().ravel(), expected, rtol=0, atol=1e-4)
    assert (expected == 0).any()


@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
@pytest.mark.parametrize("background", [0.5, 0.0])
def test_poisson_is_the_likeliest(solve: Solve, background: float) -> None:
    """ℓ1 on non-negative scenes, counts of some tens, by scipy's bounded minimiser."""
    a = convolution()
    mean = 30 * a(scene_of(1)) + background
    counts = torch.poisson(mean)
    functionals = [Poisson(counts, background=background) @ a, 0.05 * L1(), NonNegative()]
    matrix, n = dense(a), counts.numpy().ravel()

    def value(v: np.ndarray) -> tuple[float, np.ndarray]:
        t = matrix @ v + background
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.where(n > 0, n * np.log(np.where(n > 0, n, 1) / t), 0)
        slope = matrix.T @ (1 - n / t) + 0.05
        return float((t - n + logs).sum() + 0.05 * v.sum()), slope

    best = minimize(
        value, np.full(20, 10.0), jac=True, method="L-BFGS-B", bounds=[(1e-9, None)] * 20,
        options={"ftol": 1e-14, "gtol": 1e-9, "maxiter": 5000},
    )  # fmt: skip
    result = solve(*functionals, tolerance=1e-7, iterations=3000)
    assert result.objective == pytest.approx(best.fun, rel=1e-5)
    np.testing.assert_allclose(result.scene.numpy().ravel(), best.x, rtol=0, atol=2e-2)


COMPOSED: dict[str, list[Functional]] = {
    "isotropic variation, box": [0.05 * TotalVariation((4, 5), isotropic=True), Box(0, 2)],
    "variation and ridge of differences": [
        0.03 * TotalVariation((4, 5), border="free"),
        0.1 * (Ridge() @ FiniteDifference((4, 5))),
        NonNegative(),
    ],
    "two constraints": [0.02 * L1(), NonNegative(), Support(torch.arange(20).reshape(4, 5) > 4)],
    "weighted sparsity": [0.05 * (L1() @ Diagonal(torch.linspace(0.2, 2, 20).reshape(4, 5)))],
}


@pytest.mark.parametrize("case", COMPOSED.values(), ids=COMPOSED.keys())
def test_solvers_agree_at_a_minimum(case) -> None:
    """All three; no step in a random feasible direction is lower."""
    a = convolution()
    functionals = [Gaussian(data_of(a, scene_of(1))) @ a, *case]
    results = [solve(*functionals, tolerance=1e-7, iterations=2000) for solve in SOLVERS]
    least = min(result.objective for result in results)
    for result in results:
        assert result.objective == pytest.approx(least, rel=1e-5)
        assert torch.dist(result.scene, results[0].scene) < 2e-3 * results[0].scene.norm()
    best = min(results, key=lambda result: result.objective).scene
    for size in (1e-3, 0.1):
        for _ in range(20):
            near = best + size * torch.randn_like(best)
            assert sum(float(f(near)) for f in functionals) > least


def test_scenes_that_share_a_measurement() -> None:
    """A horizontal stack with groups of its planes: the conditions for a minimum, by hand."""
    a = HorizontalStack([convolution(seed=1), convolution(seed=2)])
    b = data_of(a, scene_of(1, 2))
    tau = 0.2
    v = split_admm(Gaussian(b) @ a, tau * GroupSparsity(-3), tolerance=1e-10).scene
    slope = a.adjoint(a(v) - b)
    lengths = v.norm(dim=-3, keepdim=True)
    lit = lengths > 1e-6
    assert lit.any() and not lit.all()
    assert float(torch.where(lit, slope + tau * v / lengths, 0).abs().max()) <= 1e-6
    assert float(torch.where(lit, 0, slope.norm(dim=-3, keepdim=True)).max()) <= tau * (1 + 1e-6)


FUSED = {
    "tv": (SUPPORT, 1, lambda shape: 0.05 * TotalVariation(shape)),
    "isotropic, three channels": (SUPPORT, 3, lambda s: 0.05 * TotalVariation(s, isotropic=True)),
    "l1": (SUPPORT, 3, lambda _: 0.1 * L1()),
    "no prior": (SUPPORT, 1, None),
    "no support": (None, 1, lambda shape: 0.1 * TotalVariation(shape, border="periodic")),
}


@pytest.mark.parametrize("case", FUSED.values(), ids=FUSED.keys())
def test_fused_admm_is_chosen_and_equal(case, monkeypatch) -> None:
    """To 1e-4 in objective; what it reports is in the units of the functionals."""
    support, channels, prior = case
    a = convolution(torch.float32, support=support)
    scene = torch.zeros((channels, *a.domain_shape))
    scene[..., 1:3, 1:4] = 1
    b = 40 * a(scene) + 0.3 * torch.randn((channels, *SENSOR))
    valid = torch.rand(b.shape) > 0.1
    terms = [0.7 * (Gaussian(b, valid=valid) @ a), NonNegative()]
    terms += [] if prior is None else [prior(a.domain_shape)]
    other = split_admm(*terms, tolerance=1e-5, iterations=1000)
    seen: list[Progress] = []
    monkeypatch.setattr(FRONT, "split_admm", None)
    fused = minimise(*terms, tolerance=1e-5, iterations=1000, callback=seen.append)
    assert fused.objective == pytest.approx(other.objective, rel=1e-4)
    assert torch.dist(fused.scene, other.scene) <= 0.01 * other.scene.norm()
    assert seen[-1].objective == pytest.approx(fused.objective, rel=1e-3)
    assert fused.history[-1] == seen[-1].row()
    torch.testing.assert_close(seen[-1].scene(), fused.scene, rtol=0, atol=0.02 * 40)


NOT_FUSED = {
    "float64": lambda b, a: (Gaussian(b.double()) @ convolution(), NonNegative()),
    "weights": lambda b, a: (Gaussian(b, weights=b) @ a, NonNegative()),
    "negative": lambda b, a: (Gaussian(b) @ a, L1()),
    "border": lambda b, a: (
        Gaussian(b) @ a, TotalVariation(a.domain_shape, border="periodic"), NonNegative()
    ),
    "two priors": lambda b, a: (
        Gaussian(b) @ a, TotalVariation(a.domain_shape), L1(), NonNegative()
    ),
    "operator": lambda b, a: (Gaussian(b) @ (2 * a), NonNegative()),
    "poisson": lambda b, a: (Poisson(b) @ a, NonNegative()),
    "nothing measured": lambda b, a: (Gaussian(0 * b) @ a, NonNegative()),
}  # fmt: skip


@pytest.mark.parametrize("case", NOT_FUSED.values(), ids=NOT_FUSED.keys())
def test_every_other_objective_is_split(case, monkeypatch) -> None:
    monkeypatch.setattr(FRONT, "admm", None)
    a = convolution(torch.float32)
    result = minimise(*case(torch.rand(SENSOR) + 0.5, a), iterations=4)
    assert (result.scene.shape, result.iterations) == ((1, 4, 5), 4)


@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
def test_a_denoiser_that_is_a_proximal_map(solve: Solve) -> None:
    """Soft thresholding plugged in solves the problem of the ℓ1 norm: σ² is the step."""
    a = convolution()
    data = Gaussian(data_of(a, scene_of(1))) @ a
    plugged = Denoiser(lambda v, sigma: L1().prox(v, 0.1 * sigma**2))
    with_denoiser = solve(data, plugged, tolerance=1e-9, iterations=4000)
    expected = solve(data, 0.1 * L1(), tolerance=1e-9, iterations=4000)
    torch.testing.assert_close(with_denoiser.scene, expected.scene, rtol=0, atol=1e-5)
    assert with_denoiser.objective == pytest.approx(float(data(expected.scene)), rel=1e-5)


def test_a_denoiser_is_told_the_noise() -> None:
    asked: list[float] = []

    def denoise(v: Tensor, sigma: float) -> Tensor:
        asked.append(sigma)
        return v

    v = scene_of(1)
    (0.5 * Denoiser(denoise)).prox(v, 0.02)
    (0.5 * Denoiser(denoise, sigma=0.3)).prox(v, 0.02)
    assert asked == pytest.approx([0.1, 0.3])
    with pytest.raises(DataError, match=r"made \(4, 5\) of a scene \(1, 4, 5\)"):
        Denoiser(lambda v, _: v[0]).prox(v, 0.1)
    with pytest.raises(OptionError, match="sigma is -1"):
        Denoiser(denoise, sigma=-1.0)


@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
def test_runs(solve: Solve) -> None:
    """Callback, limits, start and history as of every solver; nothing is drawn at random."""
    a = convolution()
    data = Gaussian(data_of(a, scene_of(1))) @ a
    functionals = [data, 0.05 * TotalVariation((4, 5)), NonNegative()]
    seen: list[Progress] = []
    plain = solve(*functionals, iterations=10, tolerance=0, callback=seen.append)
    assert (plain.stop_reason, plain.iterations) == ("iteration limit", 10)
    assert [row["iteration"] for row in plain.history] == [p.iteration for p in seen]
    assert seen[-1].iteration == 10 and torch.equal(seen[-1].scene(), plain.scene)
    stopped = solve(*functionals, callback=lambda p: p.iteration == 8)
    assert (stopped.stop_reason, stopped.iterations) == ("callback", 8)
    assert torch.equal(solve(*functionals, iterations=10, tolerance=0).scene, plain.scene)
    on = solve(*functionals, start=plain.scene, iterations=1, tolerance=0)
    assert torch.dist(on.scene, plain.scene) < 0.2 * plain.scene.norm()
    for options, words in (
        ({"iterations": 0}, "iterations is 0"),
        ({"tolerance": -1.0}, "tolerance -1"),
        ({"tolerance": math.nan}, "tolerance nan"),
    ):
        with pytest.raises(OptionError, match=words):
            solve(*functionals, **options)
    with pytest.raises(OptionError, match="give a data term"):
        solve(0.1 * Ridge() @ a)
    with pytest.raises(DivergenceError, match="NaN or infinity by step"):
        solve(functionals[0], Denoiser(lambda v, _: v * math.nan), iterations=8)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"relaxation": 2.0}, "relaxation is 2"),
        ({"inner": 0}, "inner 0"),
        ({"penalties": (1.0,)}, "give one above 0 for each of the 2"),
        ({"penalties": (1.0, -1.0)}, r"penalties are \[1.0, -1.0\]"),
    ],
)
def test_settings_of_admm_that_cannot_be(settings, words) -> None:
    a = convolution()
    with pytest.raises(OptionError, match=words):
        split_admm(
            Gaussian(a(scene_of(1))) @ a, TotalVariation((4, 5)), L1(), NonNegative(), **settings
        )
    with pytest.raises(OptionError, match="no functional has a gradient"):
        proximal_gradient(L1(), start=scene_of(1))


def test_the_page_runs() -> None:
    """docs/solvers.md: its problem has a result of its own shape, its functional a proximal map."""
    page = (Path(__file__).parents[2] / "docs" / "solvers.md").read_text()
    problem, stack, functional, *_ = (part.split("```")[0] for part in page.split("```python")[1:])
    names: dict[str, Any] = {"Functional": Functional}
    exec(problem.replace("tolerance=1e-4", "iterations=40"), names)
    beads, found = names["beads"], names["result"].scene
    assert found.shape == beads.shape
    assert float((found * beads).sum() / (found.norm() * beads.norm())) > 0.95
    exec(stack, names)
    assert float((names["result"].scene * beads).sum() / beads.square().sum()) > 0.5
    exec(functional, names)
    x = names["Logarithmic"]().prox(torch.tensor([2.0, -1.0]), 0.5)
    torch.testing.assert_close(x - torch.tensor([2.0, -1.0]), 0.5 / x)


def test_restarts_save_iterations() -> None:
    """A momentum that points uphill begins anew."""
    a = convolution()
    terms = [Gaussian(data_of(a, scene_of(1))) @ a, 1e-3 * Ridge()]
    with_restart, without = (
        proximal_gradient(*terms, restart=restart, tolerance=1e-9, iterations=4000)
        for restart in (True, False)
    )
    assert with_restart.stop_reason == "converged"
    assert with_restart.iterations < 0.7 * without.iterations
    assert with_restart.objective <= without.objective * (1 + 1e-9)


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
@pytest.mark.parametrize("solve", SOLVERS, ids=lambda solve: solve.__name__)
def test_on_cuda(solve: Solve) -> None:
    """What the processor computes, where the data are."""
    a = convolution()
    b = data_of(a, scene_of(1))
    other = convolution(device="cuda")
    priors = [*COMPOSED["isotropic variation, box"], Support(torch.arange(20).reshape(4, 5) > 4)]
    here = solve(Gaussian(b) @ a, *priors, iterations=40, tolerance=0).scene
    there = solve(Gaussian(b.cuda()) @ other, *priors, iterations=40, tolerance=0).scene
    assert there.is_cuda
    torch.testing.assert_close(there.cpu(), here, rtol=0, atol=1e-6)
