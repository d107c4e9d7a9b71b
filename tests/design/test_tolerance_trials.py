"""Monte Carlo, yields and tolerances for a yield, where formulas give the answer."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from torch import Tensor

from nolens.design.tolerances.parameters import Parameter, draw
from nolens.design.tolerances.sensitivity import evaluate
from nolens.design.tolerances.study import MOST_STEPS, Yield, largest_tolerance, levels

TRIALS = 4000
COEFFICIENTS = st.lists(st.floats(-3, 3), min_size=1, max_size=5)


def linear(coefficients: list[float], constant: float = 0.0):  # type: ignore[no-untyped-def]
    weights = torch.tensor(coefficients, dtype=torch.float64)
    return lambda rows: rows @ weights + constant


def normals(tolerances: list[float], middle: float = 1.0) -> tuple[Parameter, ...]:
    return tuple(
        Parameter(f"p{number}", "normal", middle, tolerance, "um")
        for number, tolerance in enumerate(tolerances)
    )


def within(found: Yield, expected: float) -> bool:
    """Five standard deviations of the binomial, or five cameras where it has none."""
    spread = math.sqrt(expected * (1 - expected) / found.trials)
    return abs(found.fraction - expected) <= max(5 * spread, 5 / found.trials)


@settings(max_examples=40)
@given(coefficients=COEFFICIENTS, limit=st.floats(-2.5, 2.5), seed=st.integers(0, 999))
def test_linear_criterion_agrees_with_its_analytic_yield(
    coefficients: list[float], limit: float, seed: int
) -> None:
    tolerances = [0.5 + 0.3 * number for number in range(len(coefficients))]
    parameters = normals(tolerances)
    sigma = math.hypot(*(c * t / 2 for c, t in zip(coefficients, tolerances, strict=True)))
    if sigma < 1e-3:
        return
    mean = sum(coefficients)
    figures = evaluate(linear(coefficients), draw(parameters, TRIALS, seed), at_once=1000)
    edge = mean + limit * sigma
    below = Yield.of(figures, edge, smaller_is_better=True)
    assert below.trials == TRIALS and within(below, float(stats.norm.cdf(limit)))
    above = Yield.of(figures, edge, smaller_is_better=False)
    assert within(above, float(stats.norm.sf(limit)))


@pytest.mark.parametrize("edge", [-1.5, -0.4, 0.3, 1.2])
def test_sum_of_uniform_ones_is_irwin_halls(edge: float) -> None:
    parameters = tuple(Parameter(f"u{n}", "uniform", 0.0, 1.0, "um") for n in range(3))
    figures = evaluate(linear([1.0] * 3), draw(parameters, 20_000, 2), at_once=7000)
    # Sum of three shares: x = (sum + 3) / 2.
    x = (edge + 3) / 2
    exact = sum((-1) ** k * math.comb(3, k) * max(0.0, x - k) ** 3 for k in range(4)) / 6
    assert within(Yield.of(figures, edge, smaller_is_better=True), exact)


@given(trials=st.integers(1, 5000), share=st.floats(0, 1), confidence=st.floats(0.5, 0.999))
def test_wilsons_interval_is_scipys(trials: int, share: float, confidence: float) -> None:
    passed = round(share * trials)
    known = stats.binomtest(passed, trials).proportion_ci(confidence, method="wilson")
    found = Yield(passed, trials).interval(confidence)
    assert found == pytest.approx((known.low, known.high), abs=1e-9)


def test_levels_are_met_by_their_share_of_cameras() -> None:
    figures = torch.arange(1, 51).double()[torch.randperm(50)]
    found = levels(figures, smaller_is_better=True)
    assert found == {0.98: 49, 0.90: 45, 0.80: 40, 0.50: 25, 0.10: 5}
    found = levels(figures, smaller_is_better=False)
    assert found == {0.98: 2, 0.90: 6, 0.80: 11, 0.50: 26, 0.10: 46}
    assert levels(torch.tensor([1.0, math.inf]), smaller_is_better=True)[0.98] == math.inf


def test_what_cannot_be_measured_meets_no_limit() -> None:
    figures = torch.tensor([1.0, math.inf, 3.0])
    assert Yield.of(figures, 1e9, smaller_is_better=True).passed == 2


def test_stopping_keeps_what_is_done() -> None:
    seen: list[int] = []

    def stop(done: int) -> bool:
        seen.append(done)
        return done >= 20

    rows = draw(normals([1.0]), 100, 0)
    figures = evaluate(linear([1.0]), rows, at_once=10, stop=stop)
    assert seen == [10, 20] and torch.equal(figures, rows[:20, 0])
    assert len(evaluate(linear([1.0]), rows, at_once=30)) == 100


def solve(coefficients: list[float], limit: float, wanted: float, bound: float = 50.0):  # type: ignore[no-untyped-def]
    """Tolerance of the first parameter; the others have ± 1, and all are around 0."""
    asked: list[float] = []

    def yield_with(tolerance: float) -> Yield:
        asked.append(tolerance)
        others = [1.0] * (len(coefficients) - 1)
        cameras = draw(normals([tolerance, *others], 0.0), TRIALS, 7)
        figures = evaluate(linear(coefficients), cameras, at_once=TRIALS)
        return Yield.of(figures, limit, smaller_is_better=True)

    return largest_tolerance(yield_with, wanted, bound), asked


@settings(max_examples=25)
@given(
    own=st.floats(0.3, 3), other=st.floats(-1, 1), wanted=st.floats(0.6, 0.97),
    room=st.floats(1.3, 4),
)  # fmt: skip
def test_tolerance_for_a_yield_of_a_linear_criterion(
    own: float, other: float, wanted: float, room: float
) -> None:
    """P(own x + other y < limit) = wanted where the sigma of the sum is limit / z."""
    z = float(stats.norm.ppf(wanted))
    limit = room * z * max(abs(other) / 2, 0.2)
    exact = 2 * math.sqrt((limit / z) ** 2 - (other / 2) ** 2) / own
    found, asked = solve([own, other], limit, wanted)
    assert found.verdict == "found" and found.reached.fraction >= wanted
    assert len(asked) <= MOST_STEPS + max(0, math.ceil(math.log2(5 / found.tolerance)))
    # Of 4000 trials a yield is known to this, and the tolerance to that over the slope.
    spread = 5 * math.sqrt(wanted * (1 - wanted) / TRIALS)
    lowest = solve_exactly(own, other, limit, wanted + spread)
    highest = solve_exactly(own, other, limit, wanted - spread)
    assert 0.98 * lowest <= found.tolerance <= 1.01 * highest
    assert lowest < exact < highest


def solve_exactly(own: float, other: float, limit: float, wanted: float) -> float:
    if wanted <= 0.5:
        return math.inf
    squared = (limit / float(stats.norm.ppf(min(wanted, 1 - 1e-9)))) ** 2 - (other / 2) ** 2
    return 2 * math.sqrt(max(0.0, squared)) / own


def test_impossible_and_any_tolerance() -> None:
    # The other parameter alone, of sigma 1/2, passes 0.1 in 58 % of all cameras.
    found, asked = solve([1.0, 1.0], 0.1, 0.9)
    assert found.verdict == "impossible" and found.tolerance == 0 and asked == [0.0]
    assert within(found.reached, float(stats.norm.cdf(0.2)))
    found, asked = solve([0.001, 0.0], 1.0, 0.9)
    assert found.verdict == "any" and found.tolerance == 50 and found.reached.fraction == 1
    assert asked == [0.0, 50.0]


def test_same_seed_same_figures() -> None:
    def figures(seed: int) -> Tensor:
        return evaluate(linear([1.0, 2.0]), draw(normals([1.0, 1.0]), 50, seed), at_once=50)

    assert torch.equal(figures(1), figures(1)) and not torch.equal(figures(1), figures(2))


@given(edge=st.floats(0.5, 49))
def test_bisection_is_exact_to_a_hundredth(edge: float) -> None:
    found = largest_tolerance(lambda t: Yield(9 if t <= edge else 8, 10), 0.9, 50.0)
    assert 0.99 * edge <= found.tolerance <= edge
    assert found.reached == Yield(9, 10)
