"""Limits of a process: kept exactly, and without touching what keeps to them."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from mask_bench import waves

from nolens.design.masks import Limits
from nolens.errors import OptionError

GRID = 1.55


def steepest(heights: torch.Tensor) -> float:
    return max(
        float((torch.roll(heights, 1, axis) - heights).abs().max()) / GRID for axis in (0, 1)
    )


@given(
    slope=st.floats(0.01, 0.5), height=st.floats(0.5, 20), rough=st.floats(0.1, 20),
    seed=st.integers(0, 99),
)  # fmt: skip
def test_slope_and_height_hold(slope, height, rough, seed):
    limits = Limits(height, slope, 8.0)
    made = limits.enforce(waves(48, rough, seed, deviation=2.0), GRID)
    assert steepest(made) <= slope * (1 + 1e-4) + 1e-5
    assert float(made.min()) >= 0 and float(made.max()) <= height * (1 + 1e-5)


def test_what_is_within_stays():
    surface = waves(64, 0.5, 0)
    surface -= surface.min()
    limits = Limits(float(surface.max()) + 0.1, steepest(surface) * 1.001, 8.0)
    torch.testing.assert_close(limits.enforce(surface, GRID), surface)
    assert float(limits.excess(surface, GRID)) == 0


def test_enforced_surface_is_the_highest_below():
    """A spike becomes a cone of the limit's slope (in steps along rows and columns)."""
    pit = torch.full((32, 32), 5.0)
    pit[16, 16] = 0.0
    limits = Limits(10.0, 0.2, 8.0)
    made = limits.enforce(pit, GRID)
    rows, columns = torch.meshgrid(torch.arange(32) - 16, torch.arange(32) - 16, indexing="ij")
    torch.testing.assert_close(made, (0.2 * GRID * (rows.abs() + columns.abs())).clamp_max(5.0))


@given(levels=st.integers(2, 300), seed=st.integers(0, 99))
def test_levels(levels, seed):
    limits = Limits(6.0, 0.3, 8.0, levels)
    surface = limits.enforce(waves(32, 1.0, seed), GRID)
    assert limits.step_um == pytest.approx(6.0 / (levels - 1))
    steps = surface / (6.0 / (levels - 1))
    torch.testing.assert_close(steps, steps.round(), atol=1e-3, rtol=0)
    assert float(steps.max()) <= levels - 1 + 1e-3
    plain = Limits(6.0, 0.3, 8.0).enforce(waves(32, 1.0, seed), GRID)
    assert float((surface - plain).abs().max()) <= limits.step_um / 2 + 1e-5


@pytest.mark.parametrize("cycles", [1, 3, 7])
def test_smallest_feature(cycles):
    """The blur takes from a wave what a Gaussian of that width at half height takes."""
    side, feature = 64, 9.0
    wave = torch.cos(2 * math.pi * cycles * torch.arange(side) / side).expand(side, -1)
    left = Limits(10.0, 0.2, feature).smooth(wave.contiguous(), GRID)
    deviation, length = feature / math.sqrt(8 * math.log(2)), side * GRID / cycles
    wanted = math.exp(-2 * (math.pi * deviation / length) ** 2)
    torch.testing.assert_close(left, wave * wanted, atol=1e-5, rtol=1e-4)


def test_excess_counts_what_is_too_steep():
    saw = torch.zeros(16, 16)
    saw[:, ::2] = 0.3
    limits = Limits(10.0, 0.1, 8.0)
    over = 0.3 / GRID / 0.1 - 1
    assert float(limits.excess(saw, GRID)) == pytest.approx(300 * over**2, rel=1e-4)
    high = torch.zeros(16, 16)
    high[:, :8] = 12.0
    assert float(Limits(10.0, 100.0, 8.0).excess(high, GRID)) == pytest.approx(100 * 0.2**2)


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (Limits(0.0, 0.1, 8.0), "more than zero"),
        (Limits(10.0, -0.1, 8.0), "more than zero"),
        (Limits(10.0, 0.1, 3.0), "3.1 µm or more"),
        (Limits(10.0, 0.1, 8.0, 16), "64 levels or more"),
    ],
)
def test_impossible_limits(limits, words):
    with pytest.raises(OptionError, match=words):
        limits.check(GRID, quarter_um=0.16)
    assert Limits(10.0, 0.1, 8.0, 64).check(GRID, quarter_um=0.16) is None
