"""Two points: against Gaussians and Airy's discs, whose dips are known in closed form."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq
from scipy.special import j1, jn_zeros
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import RAYLEIGH_DIP, point_pair, resolved_separation


def gaussians(
    separation: float, sigma: float, *, turned: float = 0.0, fainter: float = 1.0,
    middle: tuple[float, float] = (20.3, 19.6), size: int = 41,
) -> Tensor:  # fmt: skip
    rows, columns = (torch.arange(size, dtype=torch.float64) for _ in range(2))
    picture = torch.zeros(size, size, dtype=torch.float64)
    for sign, height in ((1, 1.0), (-1, fainter)):
        row = middle[0] - sign * separation / 2 * math.sin(math.radians(turned))
        column = middle[1] + sign * separation / 2 * math.cos(math.radians(turned))
        squared = (rows - row).square()[:, None] + (columns - column).square()
        picture += height * torch.exp(-squared / (2 * sigma**2))
    return picture


def gaussian_dip(separation: float, sigma: float) -> float:
    """Of two equal Gaussians, by the peak of their sum."""
    at = torch.linspace(-separation, separation, 200001, dtype=torch.float64)
    light = sum(torch.exp(-((at - s * separation / 2) ** 2) / (2 * sigma**2)) for s in (-1, 1))
    return 1 - float(light[100000]) / float(light.max())


@settings(max_examples=25, deadline=None)
@given(
    st.floats(1.2, 2.5), st.floats(2.6, 4.5), st.floats(-85, 85),
    st.floats(-0.5, 0.5), st.floats(-0.5, 0.5),
)  # fmt: skip
def test_dip_of_gaussians(
    sigma: float, ratio: float, turned: float, row: float, column: float
) -> None:
    separation = ratio * sigma
    picture = gaussians(separation, sigma, turned=turned, middle=(20 + row, 20 + column))
    pair = point_pair(picture, separation)
    assert pair.dip == pytest.approx(gaussian_dip(separation, sigma), abs=0.01)
    off = (pair.direction_deg - turned + 90) % 180 - 90
    assert abs(off) < 6


def test_separation_that_the_rayleigh_criterion_asks_for() -> None:
    sigma = 1.6
    wanted = brentq(lambda s: gaussian_dip(s, sigma) - RAYLEIGH_DIP, 2 * sigma, 4 * sigma)
    steps = [wanted + 0.6 * (number - 2.3) for number in range(6)]
    dips = [
        sum(point_pair(gaussians(s, sigma, turned=t), s).dip for t in (0, 30, 90)) / 3
        for s in steps
    ]
    found = resolved_separation(tuple(steps), tuple(dips), (0.0,) * 6)
    assert found.value == pytest.approx(wanted, rel=0.01)
    assert found.plus_minus == pytest.approx(0.3)
    assert found.unresolved == pytest.approx(steps[2]) and found.resolved == pytest.approx(steps[3])


def test_airy_discs_at_rayleighs_distance_dip_as_much() -> None:
    """The second disc's middle on the first dark ring of the first one's."""
    ring = float(jn_zeros(1, 1)[0])
    scale = ring / 9.0
    rows = torch.arange(61, dtype=torch.float64)

    def disc(column: float) -> Tensor:
        x = torch.hypot((rows - 30)[:, None], rows - column) * scale
        x = x.clamp_min(1e-9)
        return torch.from_numpy((2 * j1(x.numpy()) / x.numpy()) ** 2)

    pair = point_pair(disc(25.5) + disc(34.5), 9.0)
    assert pair.dip == pytest.approx(RAYLEIGH_DIP, abs=0.002)
    # The light of each pushes the other's peak outwards or inwards only a little.
    assert pair.separation == pytest.approx(9.0, rel=0.05) and abs(pair.direction_deg) < 0.5


def test_the_fainter_peak_counts() -> None:
    bright, faint = gaussians(8, 1.5), gaussians(8, 1.5, fainter=0.5)
    middle = 2 * math.exp(-(4**2) / (2 * 1.5**2))
    assert 1 - point_pair(bright, 8).dip == pytest.approx(middle, rel=0.02)
    assert 1 - point_pair(faint, 8).dip == pytest.approx(0.75 * middle / 0.5, rel=0.1)


def test_one_point_has_no_dip() -> None:
    pair = point_pair(gaussians(2.0, 1.6), 2.0)
    assert pair.dip == 0 and pair.separation == 0
    assert float(pair.trace.max()) == 1
    # A weak ghost beside it is no second point.
    ghost = gaussians(0, 1.2) + 0.1 * gaussians(0, 1.2, middle=(20, 24))
    assert point_pair(ghost, 4.4).dip == 0


def test_other_targets_are_refused() -> None:
    with pytest.raises(DataError, match=r"shows point sources 12\.\d pixels apart"):
        point_pair(gaussians(12, 1.3), 5.0)
    with pytest.raises(DataError, match="no two point sources in the dark"):
        point_pair(gaussians(5, 1.3) + 0.5, 5.0)
    with pytest.raises(DataError, match="dark or not finite"):
        point_pair(torch.zeros(30, 30), 5.0)
    with pytest.raises(DataError, match="dark or not finite"):
        point_pair(torch.full((30, 30), math.nan), 5.0)


def test_interpolation_between_separations() -> None:
    angles, dips = (0.8, 0.2, 0.4, 0.6), (0.9, 0.0, 0.2, 0.3)
    found = resolved_separation(angles, dips, (0.0,) * 4)
    assert found.value == pytest.approx(0.4 + 0.2 * 0.65) and found.plus_minus == pytest.approx(0.1)
    noisy = resolved_separation(angles, dips, (0.0, 0.0, 0.04, 0.03))
    scatter = 2 * math.hypot(0.35 * 0.04, 0.65 * 0.03)
    assert noisy.plus_minus == pytest.approx(math.hypot(0.1, scatter))
    # One that is unresolved though smaller ones are resolved counts.
    assert resolved_separation((1, 2, 3), (0.5, 0.1, 0.4), (0,) * 3).unresolved == 2
    assert resolved_separation((1, 2), (0.5, 0.6), (0,) * 2) == resolved_separation(
        (2, 1), (0.6, 0.5), (0,) * 2
    )
    assert resolved_separation((1, 2), (0.5, 0.6), (0,) * 2).value is None
    assert resolved_separation((1, 2), (0.0, 0.1), (0,) * 2).resolved is None
