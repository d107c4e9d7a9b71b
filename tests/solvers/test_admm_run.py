"""A run that goes on with another measurement is one that starts from its state."""

from dataclasses import replace

import pytest
import torch
from posed import Case, pose

from nolens.operators import PixelRectangle
from nolens.solvers import AdmmState
from nolens.solvers.admm import AdmmRun
from nolens.solvers.admm_state import Balance

CASE = Case(channels=3, support=PixelRectangle(1, 2, 4, 5), saturated=0.1)
SAME, OTHER = (0.3, 2.0, 0.7), (0.9, 4.0, 0.5)


@pytest.mark.parametrize("penalties", [SAME, OTHER], ids=["same penalties", "other penalties"])
@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_measure(prior, penalties):
    problem = pose(replace(CASE, prior=prior)).problem
    data = problem.data.flip(-1) + 0.1 * problem.data.max()
    following = problem.measuring(data, problem.valid.flip(-1))
    scenes = []
    for goes_on in (True, False):
        state = AdmmState.cold(problem, SAME)
        run = AdmmRun(problem, state, balance=None, relaxation=1.8)
        run.to_check(3)
        if goes_on:
            run.measure(following, penalties)
        else:
            state.renew(following, penalties)
            run = AdmmRun(following, state, balance=None, relaxation=1.8)
        progress = run.to_check(2)
        assert (state.iteration, progress.iteration) == (2, 2)
        second = penalties[1] if prior.endswith("tv") else 0
        assert state.penalties == (penalties[0], second, penalties[2])
        scenes.append(state.scene())
    torch.testing.assert_close(*scenes, rtol=1e-5, atol=1e-6)
    assert float((scenes[0] - AdmmState.cold(problem).scene()).abs().max()) > 1e-3


@pytest.mark.parametrize("limit", [1, 2, 3, 4, 5, 9])
def test_looks_lie_at_multiples_of_four_and_at_the_limit(limit):
    problem = pose(CASE).problem
    run = AdmmRun(problem, AdmmState.cold(problem), balance=Balance(), relaxation=1.8)
    seen = []
    while run.state.iteration < limit:
        seen.append(run.to_check(limit).iteration)
    assert seen == sorted({*range(4, limit + 1, 4), limit})


def test_share_of_the_light_that_is_kept():
    """Light beside the sensor counts as lost; no light at all as kept."""
    problem = pose(Case(support=PixelRectangle(1, 2, 4, 5))).problem
    state = AdmmState.cold(problem)
    top, left, *_ = state.splits[0].sensor
    for split in state.splits:
        split.measured.zero_()
    assert state.fraction_on_sensor() == 1.0
    state.splits[0].measured[top, left] = 3.0
    assert state.fraction_on_sensor() == 1.0
    state.splits[0].measured[top - 1, left] = 1.0
    assert state.fraction_on_sensor() == pytest.approx(0.75)
