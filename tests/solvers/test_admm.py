"""ADMM follows the plain one step by step, and ends at the same minimum by default."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from posed import Case, pose
from scipy.optimize import minimize_scalar

from nolens.operators import PixelRectangle
from nolens.solvers import AdmmState, Problem, Progress, admm

BASE = Case()
CASES = {
    "even": BASE,
    "odd": replace(BASE, sensor=(5, 7), psf=(5, 7)),
    "mixed, wide psf": replace(BASE, sensor=(5, 6), psf=(8, 9)),
    "saturated": replace(BASE, saturated=0.1, seed=5),
    "region inside": replace(BASE, support=PixelRectangle(1, 2, 4, 5), saturated=0.1),
    "region partly off": replace(BASE, psf=(9, 9), support=PixelRectangle(-2, 3, 6, 8)),
    "two channels, isotropic": replace(BASE, channels=2, prior="isotropic-tv"),
    "four channels of one psf": replace(
        BASE, channels=4, psf_channels=1, support=PixelRectangle(0, 0, 5, 6), saturated=0.1
    ),
    "isotropic, odd, region": replace(
        BASE, sensor=(7, 5), psf=(7, 5), support=PixelRectangle(0, -1, 6, 6), prior="isotropic-tv"
    ),
    "l1": replace(BASE, channels=3, prior="l1", saturated=0.1),
    "l1, region": replace(
        BASE, sensor=(7, 6), psf=(7, 7), support=PixelRectangle(1, 1, 4, 4), prior="l1"
    ),
    "no prior": replace(BASE, prior="none", support=PixelRectangle(1, 1, 4, 5), seed=3),
    "no prior, odd": replace(
        BASE,
        prior="none",
        sensor=(5, 7),
        psf=(5, 7),
        support=PixelRectangle(-1, 2, 4, 3),
        saturated=0.1,
    ),
    "full view": replace(BASE, view=True, support=PixelRectangle(0, 0, 6, 8)),
    "full view, three channels": replace(BASE, view=True, channels=3, saturated=0.1),
}
MANY = {
    "eight channels, isotropic, odd": replace(
        BASE, sensor=(5, 7), psf=(5, 7), channels=8, saturated=0.1, prior="isotropic-tv"
    ),
}
"""Followed step by step alone: eight minima of the plain one take long."""
PENALTIES = (0.2, 0.6, 0.4)


def _starts(posed) -> list[np.ndarray]:  # type: ignore[no-untyped-def]
    """Uniform where the case fills the view, and zero otherwise; well apart from the limit."""
    uniform = [posed.reference(k).uniform() for k in range(posed.case.channels)]
    explained = sum(share for _, share in uniform) / len(uniform)
    assert explained > 0.95 if posed.case.view else explained < 0.85
    return [level * posed.case.view for level, _ in uniform]


@pytest.mark.parametrize("case", [*CASES.values(), *MANY.values()], ids=[*CASES, *MANY])
def test_follows_the_plain_algorithm(case):
    """With fixed penalties and no relaxation: v, w, both of every iteration, and the end."""
    steps = 12
    posed = pose(case)
    references = [posed.reference(k) for k in range(case.channels)]
    runs = [
        list(reference.admm([PENALTIES] * steps, start))
        for reference, start in zip(references, _starts(posed), strict=True)
    ]
    seen: list[tuple[float, torch.Tensor]] = []

    def callback(progress: Progress) -> None:
        seen.append((progress.objective, progress.scene()))

    plain = {"tolerance": 0, "balance": None, "relaxation": 1.0}
    # A run that is taken up again after every iteration is looked at after every one.
    state = AdmmState.cold(posed.problem, PENALTIES)
    for step in range(1, steps + 1):
        admm(posed.problem, iterations=step, state=state, callback=callback, **plain)
    result = admm(posed.problem, iterations=steps, penalties=PENALTIES, **plain)
    assert len(seen) == steps
    for step, (objective, scene) in enumerate(seen):
        iterates = [run[step] for run in runs]
        w = [r.scene(each.splits[2]) for r, each in zip(references, iterates, strict=True)]
        np.testing.assert_allclose(scene.numpy(), w, rtol=1e-4, atol=1e-5 * np.max(w) + 1e-7)
        expected = np.mean(
            [r.objective(each.v) for r, each in zip(references, iterates, strict=True)]
        )
        assert objective == pytest.approx(expected, rel=1e-4)
    if case.view:
        # The result is brought to the level at which the objective is lowest.
        splits = [run[-1].splits[2] for run in runs]
        levels = [_best_level(r, split) for r, split in zip(references, splits, strict=True)]
        w = [f * r.scene(split) for r, f, split in zip(references, levels, splits, strict=True)]
        ends = [r.objective(r.embed(each)) for r, each in zip(references, w, strict=True)]
    else:
        ends = [r.objective(run[-1].splits[2]) for r, run in zip(references, runs, strict=True)]
    scales = np.array([r.scale for r in references])[:, None, None]
    np.testing.assert_allclose(
        result.scene.numpy(), np.array(w) * scales, rtol=1e-4, atol=1e-5 * np.max(w * scales)
    )
    assert result.objective == pytest.approx(np.mean(ends), rel=1e-4)


def _best_level(reference, split) -> float:  # type: ignore[no-untyped-def]
    """Factor of a split at which the objective is lowest, by search."""
    found = minimize_scalar(
        lambda f: reference.objective(f * split), bounds=(0.2, 5), method="bounded",
        options={"xatol": 1e-9},
    )  # fmt: skip
    return float(found.x)


@cache
def _minimum(case: Case) -> tuple[float, np.ndarray]:
    """Objective and scene of the reference after many iterations."""
    posed = pose(case)
    references = [posed.reference(k) for k in range(case.channels)]
    lowest = [r.minimum() for r in references]
    objectives = [r.objective(w) for r, w in zip(references, lowest, strict=True)]
    scenes = [r.scene(w) * r.scale for r, w in zip(references, lowest, strict=True)]
    return float(np.mean(objectives)), np.array(scenes)


SETTINGS = {
    "defaults": {},
    "fixed penalties": {"penalties": (0.5, 0.5, 0.5), "balance": None},
}


@pytest.mark.parametrize("settings", SETTINGS.values(), ids=SETTINGS.keys())
@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
def test_reaches_the_minimum(case, settings):
    """Whatever the penalties are, the end is that of a long plain run."""
    posed = pose(case)
    expected, scenes = _minimum(case)
    result = admm(posed.problem, iterations=1000, tolerance=1e-5, **settings)
    assert result.objective == pytest.approx(expected, rel=1e-3, abs=2e-6)
    scene = result.scene.numpy()
    assert np.linalg.norm(scene - scenes) <= 0.05 * np.linalg.norm(scenes)


@pytest.mark.parametrize("name", ["region inside", "full view, three channels", "l1, region"])
def test_stays_at_the_minimum(name):
    """Long after it has converged: what is left then is rounding, and nothing to follow."""
    expected, _ = _minimum(CASES[name])
    result = admm(pose(CASES[name]).problem, iterations=1500, tolerance=0)
    assert result.objective == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("case", [*CASES.values(), *MANY.values()], ids=[*CASES, *MANY])
def test_objective_is_that_of_the_equation(case):
    """Of any scene, exact; and the unit norms are what they say."""
    posed = pose(case)
    problem: Problem = posed.problem
    shape = problem.scene_shape
    scene = np.random.default_rng(0).uniform(0, 0.1, shape)
    references = [posed.reference(k) for k in range(case.channels)]
    expected = np.mean([r.objective(r.embed(v)) for r, v in zip(references, scene, strict=True)])
    assert problem.objective(torch.from_numpy(scene).float()) == pytest.approx(expected, rel=1e-5)
    np.testing.assert_allclose(problem.scale.flatten(), [r.scale for r in references], rtol=1e-6)
    norms = torch.linalg.vector_norm(problem.data, dim=(-2, -1))
    torch.testing.assert_close(norms, torch.ones(case.channels))
