"""FISTA ends where ADMM ends; both Wiener filters are their formulas."""

from dataclasses import replace

import numpy as np
import pytest
from posed import Case, matrix, pose, unit_data

from nolens.operators import PixelRectangle
from nolens.solvers import admm, circulant_wiener, fista, wiener
from nolens.solvers.wiener import LinearEstimate

BASE = Case(support=PixelRectangle(1, 2, 4, 5), saturated=0.1)
CASES = {
    "tv": BASE,
    "isotropic, odd, two channels": replace(
        BASE, sensor=(5, 7), psf=(5, 9), prior="isotropic-tv", channels=2
    ),
    "l1": replace(BASE, prior="l1"),
    "no prior": replace(BASE, prior="none", support=PixelRectangle(-1, 1, 4, 4)),
    "full view": replace(BASE, view=True),
    "anywhere": replace(BASE, sensor=(5, 5), psf=(5, 5), support=None, tau=0.03),
}


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_fista_and_admm_agree(case):
    problem = pose(case).problem
    one = fista(problem, iterations=400, tolerance=0)
    other = admm(problem, iterations=1000, tolerance=1e-7, penalties=(0.5, 0.5, 0.5), balance=None)
    assert one.objective == pytest.approx(other.objective, rel=1e-3, abs=2e-6)
    difference = (one.scene - other.scene).norm()
    assert difference <= 0.03 * other.scene.norm()


def test_fista_steps_by_the_largest_eigenvalue():
    """L of the brightest channel: a smaller one may diverge, a larger one wastes iterations."""
    posed = pose(CASES["isotropic, odd, two channels"])
    norms = [np.linalg.norm(posed.reference(k).blur, 2) ** 2 for k in range(2)]
    (row,) = fista(posed.problem, iterations=1).history
    assert row["penalty_1"] == pytest.approx(max(norms), rel=1e-5)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("tau", [0.01, 1.0])
def test_circulant_wiener_is_the_formula(case, tau):
    """v = F⁻¹[conj(H) F(Cᵀb) / (|H|² + τ)], clipped."""
    posed = pose(replace(case, tau=tau))
    result = circulant_wiener(posed.problem)
    objectives = []
    for k in range(case.channels):
        reference = posed.reference(k)
        h = np.fft.fft2(reference.blur[:, 0].reshape(reference.period))
        data = np.fft.fft2(reference.b.reshape(reference.period))
        v = np.fft.ifft2(h.conj() * data / (np.abs(h) ** 2 + tau)).real
        misfit = reference.b - reference.blur @ v.ravel()
        objectives.append(0.5 * misfit @ misfit + 0.5 * tau * v.ravel() @ v.ravel())
        scene = np.maximum(reference.scene(v.ravel()), 0)
        expected = scene * reference.scale
        np.testing.assert_allclose(
            result.scene[k].numpy(), expected, rtol=0, atol=1e-5 * expected.max()
        )
    assert (result.iterations, result.stop_reason, result.history) == (1, "one shot", [])
    assert result.objective == pytest.approx(np.mean(objectives), rel=1e-4)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("tau", [0.01, 1.0])
def test_wiener_is_the_formula(case, tau):
    """(AᵀA + τ ΨᵀΨ) v = Aᵀb of the pixels that were measured and those of the scene, clipped.

    Steps that go on come to it; a picture is as near as the first fifteen and six more.
    """
    posed = pose(replace(case, tau=tau))
    height, width = posed.problem.scene_shape[1:]
    differences = _differences(height, width, goes_around=case.support is None)
    first = wiener(posed.problem)
    result = wiener(posed.problem, first.scene / posed.problem.scale)
    estimate = LinearEstimate(posed.problem)
    for _ in range(20):
        estimate.solve(tau)
    objectives = []
    for k in range(case.channels):
        a, b = matrix(posed, k), unit_data(posed, k)
        normal = a.T @ a + tau * differences.T @ differences
        v = np.linalg.solve(normal, a.T @ b)
        objectives.append(
            0.5 * np.sum((b - a @ v) ** 2) + 0.5 * tau * np.sum((differences @ v) ** 2)
        )
        exact = estimate.scene[k].numpy().ravel()
        np.testing.assert_allclose(exact, v, rtol=0, atol=1e-3 * np.abs(v).max())
        expected = np.maximum(v.reshape(height, width), 0) * posed.reference(k).scale
        error = np.abs(result.scene[k].numpy() - expected).max()
        assert error <= 0.06 * expected.max()
    assert estimate.objective(tau) == pytest.approx(np.mean(objectives), rel=1e-4)
    assert result.objective == pytest.approx(np.mean(objectives), rel=0.01)
    assert first.objective == pytest.approx(result.objective, rel=0.05)


def _differences(height, width, *, goes_around):
    """Ψ down and across, of a scene with zeros beside it, or of one that goes around."""
    rows = []
    for axis, length in ((0, height), (1, width)):
        ends = length if goes_around else length + 1
        along = np.zeros((ends, length))
        for k in range(ends):
            along[k, k % length] += 1 if k < length else 0
            if goes_around or k:
                along[k, k - 1] -= 1
        parts = (along, np.eye(width)) if axis == 0 else (np.eye(height), along)
        rows.append(np.kron(*parts))
    return np.concatenate(rows)
