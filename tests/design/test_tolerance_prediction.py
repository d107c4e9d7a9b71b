"""Sensitivities and the Taylor prediction, on polynomials whose moments are known."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch import Tensor

from nolens.design.tolerances.parameters import Parameter, draw
from nolens.design.tolerances.sensitivity import respond, sweep
from nolens.design.tolerances.sharpness import Sharpness
from nolens.design.tolerances.study import Study

NUMBERS = st.floats(-3, 3)


def parameters(kinds: list[str], middle: float = 2.0) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"p{number}", kind, middle, 0.5 + number, "um")  # type: ignore[arg-type]
        for number, kind in enumerate(kinds)
    )


KINDS = st.sampled_from(["normal", "uniform", "triangular"])


@given(weights=st.lists(NUMBERS, min_size=1, max_size=4), kind=KINDS)
def test_root_sum_square_is_exact_for_linear_criteria(weights: list[float], kind: str) -> None:
    given_ = parameters([kind] * len(weights))
    vector = torch.tensor(weights, dtype=torch.float64)
    response = respond(lambda rows: rows @ vector + 7, given_, smaller_is_better=True)
    share = {"normal": 4, "uniform": 3, "triangular": 6}[kind]
    sigma = math.sqrt(
        sum((w * each.tolerance) ** 2 / share for w, each in zip(weights, given_, strict=True))
    )
    found = response.predict()
    assert response.nominal == pytest.approx(7 + 2 * sum(weights))
    assert found.mean == pytest.approx(response.nominal)
    assert found.linear_sigma == pytest.approx(sigma, abs=1e-9)
    assert found.sigma == pytest.approx(sigma, abs=1e-6)
    for row in response.sensitivities:
        assert row.quadratic == pytest.approx(0, abs=1e-9)


@given(
    entries=st.lists(NUMBERS, min_size=6, max_size=6),
    slopes=st.lists(NUMBERS, min_size=3, max_size=3),
)
def test_second_order_is_exact_for_quadratic_criteria_of_normal_variables(
    entries: list[float], slopes: list[float]
) -> None:
    """x'Ax + b'x has the mean tr(AS) and the variance 2 tr(ASAS) + b'Sb."""
    matrix = torch.zeros(3, 3, dtype=torch.float64)
    for value, (row, column) in zip(
        entries, [(0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)], strict=True
    ):
        matrix[row, column] = matrix[column, row] = value
    vector = torch.tensor(slopes, dtype=torch.float64)
    given_ = parameters(["normal"] * 3)

    def criterion(rows: Tensor) -> Tensor:
        x = rows - 2
        return torch.einsum("ni,ij,nj->n", x, matrix, x) + x @ vector + 1

    covariance = torch.diag(torch.tensor([(each.tolerance / 2) ** 2 for each in given_]).double())
    product = matrix @ covariance
    found = respond(criterion, given_, smaller_is_better=True).predict()
    assert found.mean == pytest.approx(1 + float(product.trace()), abs=1e-9)
    variance = 2 * float((product @ product).trace()) + float(vector @ covariance @ vector)
    assert found.sigma == pytest.approx(math.sqrt(variance), rel=1e-6, abs=1e-5)


def test_square_of_other_distributions() -> None:
    """x² of a uniform x in ±1: mean 1/3, variance 4/45; of a triangular one 1/6 and 7/180."""
    for kind, mean, variance in (("uniform", 1 / 3, 4 / 45), ("triangular", 1 / 6, 7 / 180)):
        alone = (Parameter("p", kind, 0.0, 1.0, ""),)  # type: ignore[arg-type]
        found = respond(lambda rows: rows[:, 0] ** 2, alone, smaller_is_better=True).predict()
        assert found.mean == pytest.approx(mean) and found.linear_sigma == pytest.approx(0)
        assert found.sigma == pytest.approx(math.sqrt(variance))


def test_prediction_and_trials_agree_on_a_curved_criterion() -> None:
    """A product is of second order: its moments are those of the trials."""
    given_ = parameters(["normal", "triangular", "uniform"])

    def criterion(rows: Tensor) -> Tensor:
        return rows[:, 0] * rows[:, 1] + rows[:, 2] ** 2

    figures = criterion(draw(given_, 200_000, 0))
    found = respond(criterion, given_, smaller_is_better=True).predict()
    assert found.mean == pytest.approx(float(figures.mean()), rel=0.01)
    assert found.sigma == pytest.approx(float(figures.std()), rel=0.01)


def test_worst_offender_comes_first() -> None:
    given_ = parameters(["normal"] * 3)
    response = respond(
        lambda rows: 3 * (rows[:, 0] - 2) - 0.1 * rows[:, 1] + (rows[:, 2] - 2) ** 2,
        given_, smaller_is_better=True,
    )  # fmt: skip
    rows = response.sensitivities
    assert [row.parameter.name for row in rows] == ["p2", "p0", "p1"]
    assert (rows[0].minus, rows[0].plus) == pytest.approx((6.25, 6.25))
    assert (rows[0].linear, rows[0].quadratic) == pytest.approx((0, 6.25))
    assert (rows[1].minus, rows[1].plus) == pytest.approx((-1.5, 1.5))
    assert (rows[1].linear, rows[1].quadratic) == pytest.approx((1.5, 0))
    assert response.best == pytest.approx(-0.2 - 1.5)
    larger = respond(lambda rows: rows[:, 0], given_, smaller_is_better=False)
    assert larger.best == pytest.approx(2.5)


def test_a_tolerance_of_zero_changes_nothing() -> None:
    given_ = (Parameter("p", "normal", 2.0, 0.0, ""), Parameter("q", "normal", 2.0, 1.0, ""))
    response = respond(lambda rows: rows.prod(dim=1), given_, smaller_is_better=True)
    assert response.sensitivities[1].worst == 0
    assert response.predict().sigma == pytest.approx(1.0)


def test_sweep_goes_from_one_end_to_the_other() -> None:
    given_ = parameters(["normal"] * 2)
    places, figures = sweep(lambda rows: rows[:, 0] + 10 * rows[:, 1], given_, 1, 5)
    assert places.tolist() == pytest.approx([0.5, 1.25, 2.0, 2.75, 3.5])
    assert figures.tolist() == pytest.approx([2 + 10 * place for place in places.tolist()])


def test_what_cannot_be_measured_leaves_no_prediction() -> None:
    def criterion(rows: Tensor) -> Tensor:
        return torch.where(rows[:, 0] > 2.1, torch.inf, rows[:, 0])

    response = respond(criterion, parameters(["normal"]), smaller_is_better=True)
    assert math.isinf(response.sensitivities[0].plus)
    assert not math.isfinite(response.predict().sigma)


def test_budget_has_a_line_for_every_parameter() -> None:
    given_ = (
        Parameter("gap.thickness", "normal", 235.0, 20.0, "um"),
        Parameter("resin.index", "uniform", 1.47, 0.005, ""),
    )
    response = respond(
        lambda rows: 14 + 0.01 * (rows[:, 0] - 235) - 200 * (rows[:, 1] - 1.47),
        given_, smaller_is_better=True,
    )  # fmt: skip
    cameras = draw(given_, 20, 0)
    study = Study(Sharpness("line-width"), response, cameras, cameras[:, 0], {}, limit=240.0)
    first, second = study.budget
    assert (first.parameter, first.nominal, first.allowed, first.unit) == (
        "resin.index", 1.47, 0.005, "",
    )  # fmt: skip
    assert first.effect == "line-width +1 / -1 µm"
    assert second.effect == "line-width -0.2 / +0.2 µm" and second.unit == "um"
    assert study.passed is not None
    assert study.passed.passed == int((cameras[:, 0] <= 240).sum())
