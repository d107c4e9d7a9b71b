"""A run goes on from its state as if it had never stopped, but for rounding."""

from dataclasses import replace

import pytest
import torch
from posed import Case, pose

from nolens.errors import DataError
from nolens.operators import PixelRectangle
from nolens.solvers import AdmmState, Prior, admm

CASE = Case(channels=2, support=PixelRectangle(1, 2, 4, 5), saturated=0.1)
CASES = {
    "region": CASE,
    "isotropic": replace(CASE, prior="isotropic-tv"),
    "l1": replace(CASE, prior="l1"),
    "full view": Case(view=True, support=PixelRectangle(0, 0, 6, 8)),
}


def restored_state(problem, saved):
    state = AdmmState.cold(problem)
    state.restore_(saved)
    return state


@pytest.mark.parametrize("case", CASES.values(), ids=CASES.keys())
@pytest.mark.parametrize("pause", [4, 8, 120])
def test_interrupted_run_ends_like_the_whole_one(case, pause):
    problem = pose(case).problem
    whole = admm(problem, iterations=160, tolerance=0)
    state = AdmmState.cold(problem)
    admm(problem, iterations=160, tolerance=0, state=state, callback=lambda p: p.iteration == pause)
    assert state.iteration == pause
    saved = {name: tensor.clone() for name, tensor in state.arrays().items()}
    restored = restored_state(problem, saved)
    rest = admm(problem, iterations=160, tolerance=0, state=restored)
    torch.testing.assert_close(rest.scene, whole.scene, rtol=1e-3, atol=1e-4)
    assert rest.objective == pytest.approx(whole.objective, rel=1e-4)
    rows = whole.history[-len(rest.history) :]
    assert [row["iteration"] for row in rest.history] == [row["iteration"] for row in rows]
    assert rest.history[0]["objective"] == pytest.approx(rows[0]["objective"], rel=1e-4)
    assert rest.history[0]["penalty_1"] == pytest.approx(rows[0]["penalty_1"], rel=1e-4)


def test_low_frequencies_are_taken_up_again():
    problem = pose(CASES["full view"]).problem
    whole = admm(problem, iterations=40, tolerance=0, low_frequency=True)
    state = AdmmState.cold(problem)
    admm(problem, iterations=8, tolerance=0, low_frequency=True, state=state)
    restored = restored_state(problem, state.arrays())
    rest = admm(problem, iterations=40, tolerance=0, low_frequency=True, state=restored)
    torch.testing.assert_close(rest.scene, whole.scene, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    "other",
    [
        replace(CASE, sensor=(7, 9), psf=(7, 9)),
        replace(CASE, channels=3),
        replace(CASE, prior=Prior.L1.value),
    ],
    ids=["size", "channels", "prior"],
)
def test_state_of_another_problem_is_refused(other):
    saved = AdmmState.cold(pose(CASE).problem).arrays()
    if other.channels == 3 or other.sensor != CASE.sensor:
        with pytest.raises(DataError, match="another problem"):
            restored_state(pose(other).problem, saved)
    else:
        saved = AdmmState.cold(pose(other).problem).arrays()
        with pytest.raises(DataError, match="rows of channel 0 is 0×0"):
            restored_state(pose(CASE).problem, saved)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("penalties", [1.0, -1.0, 1.0], "penalties are"),
        ("penalties", [1.0, 1.0, 1e30], "penalties are"),
        ("penalties", [1.0, float("nan"), 1.0], "array penalties"),
        ("penalties", [1.0, 1.0], "array penalties"),
        ("iteration", -1, "iteration is -1"),
        ("iteration", 10**12, "iteration is 1e"),
        ("iteration", [1], "array iteration"),
        ("fills_view", [True, True], "array fills_view"),
        ("sums", [[1.0] * 15], "array sums"),
        ("sums", [[1.0] * 14] * 2, "array sums"),
        ("sums", [[-1.0] * 15] * 2, "sums of squares"),
        ("sums", None, "array sums"),
        ("scene_1", float("inf"), "scene of channel 1 holds NaN or infinity"),
    ],
)
def test_edited_state_is_refused(name, value, message):
    problem = pose(CASE).problem
    saved = AdmmState.cold(problem).arrays()
    if name.startswith("scene"):
        saved[name] = torch.full_like(saved[name], value)
    elif value is None:
        del saved[name]
    else:
        saved[name] = torch.tensor(value)
    with pytest.raises(DataError, match=message):
        restored_state(problem, saved)
