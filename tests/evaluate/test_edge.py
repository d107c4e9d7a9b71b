"""Slanted edges: against edges whose blur is known in closed form."""

import math

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import edge_response, slanted_edge


def edge(
    tilt: float, sigma: float, *, lying: bool = False, shape: tuple[int, int] = (70, 64),
    dark: float = 0.2, bright: float = 0.9,
) -> Tensor:  # fmt: skip
    rows = torch.arange(shape[0], dtype=torch.float64)[:, None] - (shape[0] - 1) / 2
    columns = torch.arange(shape[1], dtype=torch.float64) - (shape[1] - 1) / 2 + 0.3
    turned = math.radians(tilt)
    away = columns * math.cos(turned) - rows * math.sin(turned)
    picture = dark + (bright - dark) * 0.5 * (1 + torch.erf(away / (sigma * math.sqrt(2))))
    return picture.T.contiguous() if lying else picture


@settings(max_examples=25, deadline=None)
@given(
    st.floats(2.5, 22), st.booleans(), st.floats(0.7, 2.0), st.booleans(), st.booleans()
)  # fmt: skip
def test_transfer_of_a_gaussian(
    tilt: float, left: bool, sigma: float, lying: bool, swapped: bool
) -> None:
    tilt = -tilt if left else tilt
    picture = edge(tilt, sigma, lying=lying)
    found = edge_response(1 - picture if swapped else picture)
    assert found.tilt_deg == pytest.approx(tilt, abs=0.05)
    assert found.direction_deg == pytest.approx(90 - tilt if lying else tilt, abs=0.05)
    wanted = torch.exp(-2 * (math.pi * sigma * found.frequencies).square())
    assert float((found.transfer - wanted).abs().max()) < 0.015
    half = math.sqrt(math.log(2) / 2) / (math.pi * sigma)
    tenth = math.sqrt(math.log(10) / 2) / (math.pi * sigma)
    at_half, at_tenth = found.frequency_of(0.5), found.frequency_of(0.1)
    assert at_half == pytest.approx(half, rel=0.015)
    assert at_tenth == pytest.approx(tenth, rel=0.02) if tenth < 0.5 else True
    assert found.frequency_of(1e-9) is None or found.frequency_of(1e-9) > 0.3  # type: ignore[operator]
    middle = found.spread[found.at == 0]
    assert float(middle) == pytest.approx(0.5, abs=0.02)
    place = found.centre[0 if lying else 1]
    assert place == pytest.approx(31.2, abs=0.05)


def test_noise() -> None:
    generator = torch.Generator().manual_seed(0)
    picture = edge(5, 1.5)
    noisy = picture + 0.02 * torch.randn(picture.shape, generator=generator)
    found = edge_response(noisy)
    assert found.tilt_deg == pytest.approx(5, abs=0.3)
    half = math.sqrt(math.log(2) / 2) / (math.pi * 1.5)
    assert found.frequency_of(0.5) == pytest.approx(half, rel=0.1)


def test_dim_ends_are_left_out() -> None:
    picture = edge(7, 1.3, dark=0.0)
    cut = picture.clone()
    cut[:3], cut[-2:] = 0.2 * cut[:3], 0
    whole, found = edge_response(picture), edge_response(cut)
    assert found.tilt_deg == pytest.approx(7, abs=0.05)
    assert found.centre == pytest.approx((35.0, whole.centre[1] + 0.5 * math.tan(math.radians(7))),
                                         abs=0.05)  # fmt: skip
    assert found.frequency_of(0.5) == pytest.approx(whole.frequency_of(0.5), rel=0.01)


def test_target_is_a_sharp_edge() -> None:
    """Cells are means over their area, of four samples a side: nearly sinc(f) across the edge."""
    found = edge_response(slanted_edge(64, 5.0))
    assert found.tilt_deg == pytest.approx(5.0, abs=0.1)
    turn = math.pi * found.frequencies * math.cos(math.radians(5))
    wanted = torch.sin(turn) / (4 * torch.sin(turn / 4)).clamp_min(1e-9)
    assert float((found.transfer - wanted).abs()[1:].max()) < 0.02


def test_other_targets_are_refused() -> None:
    generator = torch.Generator().manual_seed(1)
    rows = torch.arange(60.0)[:, None]
    disc = (torch.hypot(rows - 30, torch.arange(60.0) - 25) < 18).float()
    half_disc = (torch.hypot(rows - 30, torch.arange(60.0)) < 28).float()
    line = torch.exp(-((torch.arange(60.0) - 30 - 0.1 * rows) ** 2))
    for picture in (torch.rand(60, 60, generator=generator), disc, half_disc, line,
                    torch.ones(40, 40)):  # fmt: skip
        with pytest.raises(DataError, match="no straight edge"):
            edge_response(picture)
    with pytest.raises(DataError, match="turn it by about 5 deg"):
        edge_response(edge(0.3, 1.0))
    with pytest.raises(DataError, match="to about 5 deg"):
        edge_response(edge(math.degrees(math.atan(0.5)), 1.0, shape=(40, 64)))
    with pytest.raises(DataError, match="at least 16×16"):
        edge_response(torch.ones(10, 40))
    with pytest.raises(DataError, match="at least 4 pixels on both sides"):
        edge_response(edge(8, 1.0, shape=(100, 22)))
