"""How a run goes and ends: callbacks, stopping, the record, and bad input."""

import importlib
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from posed import Case, pose

from nolens.errors import DataError, DivergenceError, OptionError
from nolens.operators import PixelRectangle
from nolens.solvers import Prior, Problem, Progress, admm, fista, wiener
from nolens.solvers.result import expected_end

CASE = Case(channels=2, support=PixelRectangle(1, 2, 4, 5), saturated=0.1)
FIXED = {"penalties": (0.5, 0.5, 0.5), "balance": None}
SOLVERS = {"admm": admm, "fista": fista}
LOOKS = {"admm": [4, 8, 9], "fista": [1, 2, 3, 4, 5, 6, 7, 8, 9]}
"""Iterations, of nine, after which a run is looked at."""
KERNEL = importlib.import_module("nolens.kernels.admm")


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS.keys())
def test_callback_sees_every_look(solve):
    problem = pose(CASE).problem
    seen: list[Progress] = []
    scenes: list[torch.Tensor] = []

    def callback(progress: Progress) -> None:
        seen.append(progress)
        scenes.append(progress.scene())

    result = solve(problem, iterations=9, tolerance=0, callback=callback)
    assert [progress.iteration for progress in seen] == LOOKS[solve.__name__]
    assert (result.iterations, result.stop_reason) == (9, "iteration limit")
    assert [progress.row() for progress in seen] == result.history
    assert torch.equal(problem.unscale(scenes[-1]), result.scene)
    assert all((scene >= 0).all() for scene in scenes)
    assert scenes[-1].shape == (2, 4, 5)
    assert not torch.equal(scenes[-1], scenes[-2])


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS.keys())
def test_callback_stops(solve):
    result = solve(pose(CASE).problem, tolerance=0, callback=lambda p: p.iteration == 4)
    assert (result.iterations, result.stop_reason) == (4, "callback")
    same = solve(pose(CASE).problem, tolerance=0, iterations=4)
    assert torch.equal(result.scene, same.scene)


@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_admm_stops_where_residuals_are_small(prior):
    problem = pose(replace(CASE, prior=prior)).problem
    result = admm(problem, iterations=3000, tolerance=1e-3, **FIXED)
    assert result.stop_reason == "converged"
    assert result.history[-1]["iteration"] == result.iterations
    *before, last = result.history
    assert max(last["primal_residual"], last["dual_residual"]) <= 1e-3
    assert all(max(row["primal_residual"], row["dual_residual"]) > 1e-3 for row in before)
    closer = admm(problem, iterations=3000, tolerance=1e-5, **FIXED)
    assert closer.iterations > result.iterations


def test_residuals_are_those_of_the_splits():
    """Primal: the worst ‖Kv − x‖ over ‖x‖; dual: the worst ‖x − x_before‖ over ‖x‖."""
    case = replace(CASE, channels=1)
    posed = pose(case)
    reference = posed.reference(0)
    level, share = reference.uniform()
    assert share < 0.85
    result = admm(posed.problem, iterations=6, tolerance=0, relaxation=1.3, **FIXED)
    run = list(reference.admm([(0.5, 0.5, 0.5)] * 6, 0 * level, 1.3))
    for row, each in zip(result.history, [run[3], run[5]], strict=True):
        primal, dual = [], []
        for kv, x, before in zip(each.fields, each.splits, each.splits_before, strict=True):
            size = math.sqrt(x @ x)
            primal.append(math.sqrt((kv - x) @ (kv - x)) / size)
            dual.append(math.sqrt((x - before) @ (x - before)) / size)
        assert row["primal_residual"] == pytest.approx(max(primal), rel=1e-3)
        assert row["dual_residual"] == pytest.approx(max(dual), rel=1e-3)


def test_fista_stops_where_the_scene_stands():
    result = fista(pose(CASE).problem, iterations=3000, tolerance=1e-3)
    assert result.stop_reason == "converged"
    assert 1 < result.iterations < 3000
    assert result.history[-1]["dual_residual"] <= 1e-3 < result.history[-2]["dual_residual"]


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS.keys())
@pytest.mark.parametrize("prior", ["tv", "isotropic-tv", "l1", "none"])
def test_history_is_finite_and_complete(solve, prior):
    result = solve(pose(replace(CASE, prior=prior)).problem, iterations=9, tolerance=0)
    assert [row["iteration"] for row in result.history] == LOOKS[solve.__name__]
    for row in result.history:
        assert {"objective", "primal_residual", "dual_residual", "penalty_1"} <= row.keys()
        assert all(math.isfinite(value) for value in row.values())
    assert result.history[-1]["objective"] < result.history[0]["objective"] + 1


@pytest.mark.parametrize("solve", SOLVERS.values(), ids=SOLVERS.keys())
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_what_breaks_while_iterating_is_an_error(solve, value, monkeypatch):
    problem = pose(CASE).problem
    calls = 0
    if solve is admm:
        inverse = KERNEL.ifft2_

        def broken(spectrum: torch.Tensor) -> torch.Tensor:
            nonlocal calls
            calls += 1
            field = inverse(spectrum)
            if calls == 1:  # of the first channel, in the iteration that is looked at
                field[0, 0] = value
            return field

        monkeypatch.setattr(KERNEL, "ifft2_", broken)
    else:
        adjoint = problem.forward.adjoint

        def broken_adjoint(y: torch.Tensor) -> torch.Tensor:
            nonlocal calls
            calls += 1
            return adjoint(y) if calls != 3 else adjoint(y) * value

        monkeypatch.setattr(problem.forward, "adjoint", broken_adjoint)
    with pytest.raises(DivergenceError, match="step 4" if solve is admm else "step 3"):
        solve(problem, iterations=10, tolerance=0)


OPTIONS = [
    (admm, {"iterations": 0}, "iterations is 0"),
    (admm, {"iterations": -5}, "-5"),
    (admm, {"tolerance": -0.5}, "-0.5"),
    (admm, {"tolerance": math.nan}, "nan"),
    (admm, {"scene_tolerance": -0.25}, "-0.25"),
    (admm, {"penalties": (0.1, 0.0, 1.0)}, "0.1, 0.0, 1.0"),
    (admm, {"penalties": (0.1, 1.0, -2.0)}, "-2.0"),
    (admm, {"penalties": (math.inf, 1.0, 1.0)}, "inf"),
    (admm, {"penalties": (math.nan, 1.0, 1.0)}, "nan"),
    (admm, {"relaxation": 0.0}, "relaxation is 0"),
    (admm, {"relaxation": 2.0}, "relaxation is 2"),
    (admm, {"relaxation": math.nan}, "nan"),
    (fista, {"iterations": 0}, "iterations is 0"),
    (fista, {"tolerance": -0.5}, "-0.5"),
    (fista, {"tolerance": math.nan}, "nan"),
]


@pytest.mark.parametrize(("solve", "options", "message"), OPTIONS)
def test_bad_option_is_quoted(solve, options, message):
    with pytest.raises(OptionError) as caught:
        solve(pose(CASE).problem, **options)
    assert message in str(caught.value)


def _ones(*shape: int) -> torch.Tensor:
    return torch.ones(shape)


def _with(value: float) -> torch.Tensor:
    data = torch.ones(1, 4, 5)
    data[0, 2, 3] = value
    return data


BAD = {
    "NaN in the data": ({"data": _with(math.nan)}, DataError, "measurement holds NaN"),
    "infinite data": ({"data": _with(math.inf)}, DataError, "measurement holds NaN"),
    "NaN in the PSF": ({"psf": _with(math.nan)}, DataError, "PSF holds NaN"),
    "zero data": ({"data": 0 * _ones(1, 4, 5)}, DataError, "zero everywhere"),
    "one zero channel": (
        {"data": torch.cat([_ones(1, 4, 5), 0 * _ones(1, 4, 5)])},
        DataError,
        "at least one channel",
    ),
    "zero PSF": ({"psf": 0 * _ones(1, 4, 5)}, DataError, "PSF is zero"),
    "all saturated": (
        {"valid": torch.zeros(1, 4, 5, dtype=torch.bool)},
        DataError,
        "without saturated pixels",
    ),
    "PSF lower than the sensor": ({"psf": _ones(1, 3, 5)}, DataError, "3×5.*4×5"),
    "PSF narrower": ({"psf": _ones(1, 4, 4)}, DataError, "4×4.*4×5"),
    "channels": ({"psf": _ones(2, 4, 5), "data": _ones(3, 4, 5)}, DataError, "2 channels.* 3"),
    "a fourth axis": ({"data": _ones(2, 1, 4, 5)}, DataError, r"\(2, 1, 4, 5\)"),
    "channels last": ({"data": _ones(9, 5, 3)}, DataError, r"\(9, 5, 3\).*permute\(2, 0, 1\)"),
    "channels of the PSF last": ({"psf": np.ones((9, 5, 1))}, DataError, r"PSF is.*transpose"),
    "counts": ({"data": _ones(1, 4, 5).to(torch.int16)}, DataError, "int16.*black level"),
    "text": ({"psf": [["a", "b"]]}, DataError, "PSF is list"),
    "mask of another size": (
        {"valid": torch.ones(1, 4, 4, dtype=torch.bool)},
        DataError,
        r"\(1, 4, 4\).*\(1, 4, 5\)",
    ),
    "mask that is not bool": ({"valid": _ones(1, 4, 5)}, DataError, "float32.*be bool"),
    "negative tau": ({"tau": -0.25}, OptionError, "-0.25"),
    "tau is NaN": ({"tau": math.nan}, OptionError, "nan"),
    "tau is infinite": ({"tau": math.inf}, OptionError, "inf"),
    "tau is text": ({"tau": "small"}, OptionError, "'small'.*0 or more"),
    "unknown prior": ({"prior": "foo"}, OptionError, "'foo'; give one of auto, tv, isotropic-tv"),
    "prior is a function": ({"prior": lambda x: x}, OptionError, "lambda.*one of auto"),
    "three sides": ({"support": (1, 2, 3)}, OptionError, r"\(1, 2, 3\); give \(height, width\)"),
    "half a pixel": ({"support": (1.5, 2)}, OptionError, r"\(1.5, 2\)"),
    "region is text": ({"support": "2x2"}, OptionError, "'2x2'"),
    "region beside": ({"support": PixelRectangle(40, 0, 2, 2)}, OptionError, "pixels 40 to 41"),
}


@pytest.mark.parametrize(("changed", "error", "message"), BAD.values(), ids=BAD.keys())
def test_bad_problem_is_refused(changed, error, message):
    with pytest.raises(error, match=message):
        Problem.build(**{"psf": _ones(1, 4, 5), "data": _ones(1, 4, 5), **changed})


@pytest.mark.parametrize("prior", [Prior.TV, Prior.ISOTROPIC_TV, Prior.L1, Prior.NONE])
def test_what_a_notebook_has_poses_the_same_problem(prior):
    """Words, NumPy's arrays, sizes alone, a PSF that asks for gradients."""
    posed = pose(
        replace(CASE, channels=1, prior=prior.value, support=PixelRectangle.centred(4, 6, (6, 8)))
    )
    wanted = admm(posed.problem, iterations=8).scene
    ways = {
        "arrays": {"psf": posed.psf, "data": posed.data, "valid": posed.valid},
        "without channels": {"psf": posed.psf[0], "data": posed.data[0], "valid": posed.valid[0]},
        "a view": {"psf": posed.psf[:, ::-1].copy()[:, ::-1], "support": np.array([4, 6])},
        "four sides": {"support": (1, 1, 4, 6)},
        "gradients": {"psf": torch.from_numpy(posed.psf).float().requires_grad_()},
    }
    for name, given in ways.items():
        problem = posed.pose(**{"support": (4, 6), "prior": prior.value, **given})
        assert problem.prior is prior, name
        assert problem.forward.support == PixelRectangle(1, 1, 4, 6), name
        assert torch.equal(admm(problem, iterations=8).scene, wanted), name


def test_the_photograph_is_the_sensors_frame_or_the_region():
    for support, shape in ((None, (2, 6, 8)), (PixelRectangle(1, 2, 4, 5), (2, 4, 5))):
        problem = pose(replace(CASE, support=support)).problem
        for solve in (admm, fista, wiener):
            result = solve(problem)
            assert result.photograph.shape == shape
            top, left = (-at for at in problem.forward.geometry.origin)
            if support is None:
                assert result.scene.shape[1] > 6
                assert torch.equal(result.photograph[:, 0, 0], result.scene[:, top, left])
            assert len(repr(result)) < 120 and len(repr(problem)) < 200


def test_wiener_needs_a_weight():
    with pytest.raises(DataError, match="tau is 0"):
        wiener(pose(replace(CASE, tau=0.0)).problem)


def test_what_saturated_pixels_hold_is_not_looked_at():
    data = _with(math.nan)
    Problem.build(_ones(1, 4, 5), data, valid=torch.isfinite(data))


def test_admm_refuses_double_precision():
    problem = Problem.build(_ones(1, 4, 5).double(), _ones(1, 4, 5).double())
    with pytest.raises(DataError, match="float64"):
        admm(problem)


def test_the_end_is_expected_where_residuals_fall_evenly():
    rows = [
        {"iteration": k, "primal_residual": 0.2 * 0.9**k, "dual_residual": 0.1 * 0.9**k}
        for k in (4, 8, 12)
    ]
    end = expected_end(rows, 1e-3)
    assert end == math.ceil(math.log(1e-3 / 0.2) / math.log(0.9))
    assert expected_end(rows[:1], 1e-3) is None and expected_end(rows[::-1], 1e-3) is None
    assert expected_end(rows, 1.0) == 12 and expected_end(rows, 0.0) is None
    assert expected_end(rows[:1], math.inf) == rows[0]["iteration"]
