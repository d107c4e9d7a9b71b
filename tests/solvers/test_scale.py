"""What must not matter: units, masked values, and what other channels hold."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from posed import Case, pose

from nolens.operators import PixelRectangle
from nolens.solvers import Problem, Result, admm, fista, wiener

BASE = Case(channels=3, support=PixelRectangle(1, 1, 4, 5), saturated=0.15)
CASES = {
    "tv": BASE,
    "l1, anywhere": replace(BASE, prior="l1", support=None),
    "isotropic, full view": replace(
        BASE, prior="isotropic-tv", view=True, sensor=(7, 7), psf=(7, 9)
    ),
}
FIXED = {"penalties": (0.5, 0.5, 0.5), "balance": None}


def _run(method: str, problem: Problem) -> Result:
    if method == "fista":
        return fista(problem, iterations=60)
    if method == "wiener":
        return wiener(problem)
    if method == "defaults":
        return admm(problem, iterations=25)
    return admm(problem, iterations=2000, **FIXED)  # stops by itself


METHODS = ["defaults", "fixed", "fista", "wiener"]
FACTORS = {
    "psf": (37, 1, 1 / 37),
    "dim psf": (1e-9, 1, 1e9),
    "dim data": (1, 1e-4, 1e-4),
    "bright data": (1, 1e6, 1e6),
    "both": (37, 1e6, 1e6 / 37),
    "each channel's own": (
        np.array([3, 1e-3, 10])[:, None, None],
        np.array([1e-3, 7, 1e5])[:, None, None],
        np.array([1e-3 / 3, 7e3, 1e4])[:, None, None],
    ),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_constants_go_straight_through(case, method):
    posed = pose(case)
    plain = _run(method, posed.problem)
    assert plain.scene.max() > 0
    for name, (of_psf, of_data, of_scene) in FACTORS.items():
        result = _run(method, posed.pose(of_psf, of_data))
        expected = plain.scene.double().numpy() * of_scene
        error = np.abs(result.scene.numpy() - expected).max(axis=(1, 2))
        assert (error <= 1e-5 * expected.max(axis=(1, 2))).all(), name
        assert result.objective == pytest.approx(plain.objective, rel=1e-5), name
        assert result.iterations == plain.iterations, name
        assert result.stop_reason == plain.stop_reason, name


@pytest.mark.parametrize("method", METHODS)
def test_a_power_of_two_changes_no_bit(method):
    posed = pose(BASE)
    plain = _run(method, posed.problem)
    scaled = _run(method, posed.pose(64, 2**-10))
    assert torch.equal(scaled.scene, plain.scene * 2**-16)
    assert scaled.objective == plain.objective
    assert scaled.history == plain.history


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("value", [0.0, -3.0, 1e9])
def test_values_of_saturated_pixels_do_not_matter(method, value):
    posed = pose(BASE)
    assert not posed.valid.all()
    data = torch.from_numpy(np.where(posed.valid, posed.data, value)).float()
    plain, changed = _run(method, posed.problem), _run(method, posed.pose(data=data))
    assert torch.equal(changed.scene, plain.scene)
    assert changed.history == plain.history


# FISTA's step is that of the brightest transfer function, so with PSFs that differ it is shared.
@pytest.mark.parametrize(
    ("method", "psf_channels"),
    [("fixed", 1), ("fixed", 3), ("fista", 1), ("wiener", 1), ("wiener", 3)],
)
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_channels_together_are_the_channels_one_by_one(case, method, psf_channels):
    """With penalties that do not hang on the other channels, and a given number of iterations."""

    def run(problem: Problem) -> Result:
        if method == "fixed":
            return admm(problem, iterations=30, tolerance=0, **FIXED)
        return fista(problem, iterations=30, tolerance=0) if method == "fista" else wiener(problem)

    posed = pose(replace(case, psf_channels=psf_channels))
    together = run(posed.problem)
    objectives = []
    for k in range(3):
        p = k % psf_channels
        alone = run(
            posed.pose(
                psf=torch.from_numpy(posed.psf[p : p + 1]).float(),
                data=torch.from_numpy(posed.data[k : k + 1]).float(),
                valid=torch.from_numpy(posed.valid[k : k + 1]),
            )
        )
        error = (together.scene[k] - alone.scene[0]).abs().max()
        assert error <= 1e-4 * alone.scene.max()
        objectives.append(alone.objective)
    assert together.objective == pytest.approx(np.mean(objectives), rel=1e-4)


def test_a_wide_psf_counts_as_far_as_it_reaches():
    """PSF pixels that no light takes from support to sensor change nothing, not even the norm."""
    case = replace(BASE, psf=(15, 16), channels=1)
    posed = pose(case)
    reference = posed.reference(0)
    far = np.ones((1, *case.psf))
    for i in range(case.psf[0]):
        for j in range(case.psf[1]):
            down, right = i - case.psf[0] // 2, j - case.psf[1] // 2
            rows = range(1 + down, 1 + 4 + down)
            columns = range(1 + right, 1 + 5 + right)
            if rows[0] < 6 and rows[-1] >= 0 and columns[0] < 8 and columns[-1] >= 0:
                far[0, i, j] = 0
    assert far.sum() > 50
    changed = posed.pose(psf=torch.from_numpy(posed.psf + 5 * far).float())
    assert torch.equal(changed.scale, posed.problem.scale)
    assert torch.equal(changed.forward.transfer, posed.problem.forward.transfer)
    assert float(changed.scale) == pytest.approx(reference.scale, rel=1e-6)
