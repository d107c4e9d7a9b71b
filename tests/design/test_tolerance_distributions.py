"""Distributions against scipy's, and random numbers that stay the same."""

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from nolens.design.tolerances.parameters import Parameter, draw, random_fractions

SIZES = st.floats(0.01, 100)


def oracle(parameter: Parameter) -> "stats.rv_continuous":
    middle, t = parameter.middle, parameter.tolerance
    if parameter.distribution == "uniform":
        return stats.uniform(middle - t, 2 * t)
    if parameter.distribution == "triangular":
        return stats.triang(0.5, middle - t, 2 * t)
    if parameter.at_most is None:
        return stats.norm(middle, t / 2)
    cut = parameter.at_most / (t / 2)
    return stats.truncnorm(-cut, cut, middle, t / 2)


@given(
    kind=st.sampled_from(["normal", "uniform", "triangular"]),
    middle=st.floats(-100, 100),
    tolerance=SIZES,
    cut=st.none() | st.floats(0.3, 4),
)
def test_distributions_are_scipys(
    kind: str, middle: float, tolerance: float, cut: float | None
) -> None:
    at_most = cut * tolerance if cut is not None and kind == "normal" else None
    parameter = Parameter("p", kind, middle, tolerance, "um", at_most)  # type: ignore[arg-type]
    known = oracle(parameter)
    asked = np.array([1e-6, 0.01, 0.2, 0.5, 0.77, 0.98, 1 - 1e-6])
    assert parameter.values(asked) == pytest.approx(known.ppf(asked), rel=1e-7, abs=1e-7)
    assert parameter.variance == pytest.approx(known.var(), rel=1e-6)
    unit = oracle(Parameter("p", kind, 0.0, tolerance, "um", at_most))  # type: ignore[arg-type]
    assert parameter.fourth_moment == pytest.approx(unit.moment(4), rel=1e-5)


def test_a_cut_scales_with_its_tolerance() -> None:
    wide = Parameter("p", "normal", 5.0, 2.0, "um", 3.0).with_tolerance(4.0)
    assert (wide.tolerance, wide.at_most) == (4.0, 6.0)
    assert float(draw((wide,), 10_000, 0).sub(5).abs().max()) <= 6.0


def test_drawn_cameras_follow_their_distribution() -> None:
    kinds = ("normal", "uniform", "triangular")
    parameters = tuple(Parameter(kind, kind, 10.0, 2.0, "um") for kind in kinds)  # type: ignore[arg-type]
    drawn = draw(parameters, 20_000, 3)
    for parameter, column in zip(parameters, drawn.T, strict=True):
        assert stats.kstest(column.numpy(), oracle(parameter).cdf).pvalue > 1e-3
    assert float(torch.corrcoef(drawn.T).triu(1).abs().max()) < 0.03


def test_more_trials_begin_with_those_of_fewer() -> None:
    one, other = Parameter("a", "normal", 0, 1, ""), Parameter("b", "uniform", 0, 1, "")
    few, many = draw((one, other), 17, 4), draw((one, other), 400, 4)
    assert torch.equal(many[:17], few)
    # Another parameter more or less changes nothing for the rest.
    assert torch.equal(draw((other,), 17, 4)[:, 0], few[:, 1])
    assert not torch.equal(draw((one, other), 17, 5), few)


def test_fractions_are_between_0_and_1() -> None:
    found = random_fractions("resin.thickness", 50_000, 0)
    assert 0 < found.min() < 1e-3 and 1 - 1e-3 < found.max() < 1
