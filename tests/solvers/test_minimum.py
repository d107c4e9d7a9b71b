"""The minimum against scipy's optimisers, and against the conditions for a minimum."""

from dataclasses import replace

import numpy as np
import pytest
from posed import Case, Posed, matrix, pose, unit_data
from scipy.optimize import lsq_linear, minimize, nnls

from nolens.operators import PixelRectangle
from nolens.solvers import admm

BASE = Case(support=PixelRectangle(1, 2, 4, 4), saturated=0.15)
GEOMETRIES = {
    "even": BASE,
    "odd": replace(BASE, sensor=(7, 5), psf=(7, 5), support=PixelRectangle(-1, 1, 5, 3)),
    "wide psf": replace(BASE, sensor=(5, 6), psf=(9, 8), support=PixelRectangle(-1, -1, 4, 5)),
}
FIXED = {"iterations": 1500, "tolerance": 1e-7, "penalties": (0.5, 0.5, 0.5), "balance": None}


def _solve(posed: Posed, **settings: object) -> np.ndarray:
    """Scene in unit norms, flat."""
    result = admm(posed.problem, **{**FIXED, **settings})  # type: ignore[arg-type]
    return (result.scene / posed.problem.scale)[0].double().numpy().ravel()


@pytest.mark.parametrize("case", GEOMETRIES.values(), ids=GEOMETRIES.keys())
def test_without_prior_it_is_non_negative_least_squares(case):
    posed = pose(replace(case, prior="none"))
    expected, _ = nnls(matrix(posed, 0), unit_data(posed, 0))
    got = _solve(posed)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-3 * expected.max())
    assert (got >= 0).all()


@pytest.mark.parametrize("case", GEOMETRIES.values(), ids=GEOMETRIES.keys())
def test_l1_is_a_bounded_quadratic(case):
    posed = pose(replace(case, prior="l1", tau=0.03))
    a, b = matrix(posed, 0), unit_data(posed, 0)

    def value_and_gradient(v: np.ndarray) -> tuple[float, np.ndarray]:
        misfit = a @ v - b
        return 0.5 * misfit @ misfit + 0.03 * v.sum(), a.T @ misfit + 0.03

    found = minimize(
        value_and_gradient,
        np.full(a.shape[1], 0.1),
        jac=True,
        method="L-BFGS-B",
        bounds=[(0, None)] * a.shape[1],
        options={"ftol": 1e-15, "gtol": 1e-10, "maxiter": 5000},
    )
    np.testing.assert_allclose(_solve(posed), found.x, rtol=0, atol=1e-3 * found.x.max())


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv"])
@pytest.mark.parametrize("case", GEOMETRIES.values(), ids=GEOMETRIES.keys())
def test_total_variation_meets_the_conditions_for_a_minimum(case, prior):
    """A*(Av − b) + τΨ*p = s for some p in the subgradient of the variation and s ≥ 0, s·v = 0."""
    posed = pose(replace(case, prior=prior))
    reference = posed.reference(0)
    a, b = matrix(posed, 0), unit_data(posed, 0)
    scene = _solve(posed)
    gradient = a.T @ (a @ scene - b)
    shape = posed.problem.forward.domain_shape
    steps = reference.difference @ reference.embed(scene.reshape(shape))
    back = reference.difference.T[reference.support]
    rows, columns = np.split(steps, 2)
    length = np.tile(np.hypot(rows, columns), 2) if prior == "isotropic-tv" else np.abs(steps)
    moving = length > 1e-3 * length.max()
    fixed = np.where(moving, steps / np.maximum(length, 1e-300), 0)
    # Unknown: p where nothing moves (|p| ≤ 1, a box around the isotropic disc), s where v = 0.
    dark = scene < 1e-4 * scene.max()
    unknown = np.concatenate(
        [posed.case.tau * back[:, ~moving], -np.eye(scene.size)[:, dark]], axis=1
    )
    bounds = np.concatenate([np.full((~moving).sum(), -1.0), np.zeros(dark.sum())])
    upper = np.concatenate([np.full((~moving).sum(), 1.0), np.full(dark.sum(), np.inf)])
    right = -(gradient + posed.case.tau * back @ fixed)
    found = lsq_linear(unknown, right, bounds=(bounds, upper), tol=1e-12)
    rest = np.abs(unknown @ found.x - right).max()
    assert rest <= 2e-3 * posed.case.tau + 1e-6
    assert moving.any()
    assert (~moving).any()


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_no_nearby_scene_is_better(prior):
    """The program's own objective does not fall in any of many feasible directions."""
    posed = pose(replace(BASE, prior=prior, channels=2, tau=0.02))
    result = admm(posed.problem, **FIXED)
    scale = posed.problem.scale
    rng = np.random.default_rng(6)
    unit = result.scene / scale
    assert result.objective == pytest.approx(posed.problem.objective(unit), rel=1e-6)
    for size in (0.02, 0.1):
        for _ in range(40):
            other = unit.clone()
            cells = rng.integers(0, other[0].numel(), 3)
            other[rng.integers(2)].view(-1)[cells] += size * float(rng.standard_normal())
            assert posed.problem.objective(other.clamp_min(0)) >= result.objective - 1e-6
