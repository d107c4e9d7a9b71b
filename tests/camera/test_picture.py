"""Exposure and the sRGB curve."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.camera import arrange_rgb, exposure_white, linear_from_srgb, srgb_from_linear
from nolens.camera.values import squares
from nolens.errors import DataError


def test_white_is_a_percentile_of_the_brightest_channel():
    # Brightest channels 1…1000 in some order: 995 of 1000 do not exceed 995.
    brightest = torch.randperm(1000, generator=torch.manual_seed(0)).float().reshape(1, 20, 50) + 1
    radiance = torch.cat([brightest * 0.5, brightest, brightest * 0])
    assert exposure_white(radiance) == 995
    assert exposure_white(brightest) == 995


def test_a_few_points_of_light_are_not_lost():
    radiance = torch.zeros(1, 100, 100)
    radiance[0, 3, 4] = 0.25
    assert exposure_white(radiance) == 0.25


@given(st.floats(1e-6, 1e6))
def test_white_follows_the_scale(scale):
    radiance = torch.rand(3, 20, 30, generator=torch.manual_seed(0))
    assert exposure_white(radiance * scale) == pytest.approx(exposure_white(radiance) * scale)


@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_nothing_to_show(value):
    with pytest.raises(DataError):
        exposure_white(torch.full((1, 8, 8), value))


def test_srgb_at_known_points():
    # 8-bit codes of linear 0, 0.0031308 (where both branches meet), 0.18, 0.5 and 1.
    codes = srgb_from_linear(torch.tensor([-1, 0, 0.0031308, 0.18, 0.5, 1, 2])) * 255
    assert codes.round().tolist() == [0, 0, 10, 118, 188, 255, 255]
    below, above = srgb_from_linear(torch.tensor([0.0031308, 0.0031309]))
    assert abs(above - below) < 1e-5


@given(st.floats(0, 1, width=32))
def test_srgb_round_trip(value):
    x = torch.tensor(value)
    torch.testing.assert_close(linear_from_srgb(srgb_from_linear(x)), x, atol=1e-6, rtol=1e-5)


def test_channels_go_where_a_picture_has_them():
    r, g, b = torch.rand(3, 4, 5)
    assert torch.equal(arrange_rgb(torch.stack([g]), ("G",)), torch.stack([g]))
    assert torch.equal(
        arrange_rgb(torch.stack([b, r]), ("B", "R")), torch.stack([r, torch.zeros_like(g), b])
    )
    assert torch.equal(arrange_rgb(torch.stack([r, g, b]), ("R", "G", "B")), torch.stack([r, g, b]))


def test_squares_of_many_values_are_exact():
    planes = 3 + torch.rand((2, 1000, 2000), generator=torch.manual_seed(0))
    exact = planes.double().square().sum(dim=(-2, -1))
    torch.testing.assert_close(squares(planes), exact, rtol=1e-7, atol=0)
