"""Siemens stars: against stars whose blur is known in closed form."""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter
from scipy.special import ive
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import (
    FlatPicture,
    find_star,
    resolved_radii,
    siemens_star,
    star_contrast,
)


def blurred_order(order: int, radius: Tensor, sigma: float) -> Tensor:
    """cos(order φ) blurred by a Gaussian is this times cos(order φ), exactly."""
    z = (radius / (2 * sigma)).square()
    bessel = ive((order - 1) / 2, z.numpy()) + ive((order + 1) / 2, z.numpy())
    return math.sqrt(math.pi / 2) * z.sqrt() * torch.as_tensor(bessel)


def star(
    periods: int, sigma: float, *, centre: tuple[float, float] = (60.4, 63.7), radius: float = 52,
    shape: tuple[int, int] = (121, 128), level: float = 0.0, turned: float = 0.0,
) -> Tensor:  # fmt: skip
    """A star of evenly bright and dark spokes, blurred; ten harmonics of it."""
    rows = torch.arange(shape[0], dtype=torch.float64)[:, None] - centre[0]
    columns = torch.arange(shape[1], dtype=torch.float64) - centre[1]
    away = torch.hypot(rows, columns)
    turn = torch.atan2(-rows, columns.expand(rows.shape[0], -1)) - turned
    light = torch.full_like(away, 0.5)
    for number in range(10):
        order = (2 * number + 1) * periods
        wave = blurred_order(order, away, sigma) * torch.cos(order * turn)
        light += (-1) ** number * 2 / (math.pi * (2 * number + 1)) * wave
    return level + light * (away <= radius)


@pytest.mark.parametrize(
    ("periods", "sigma"), [(16, 0.8), (16, 2.5), (25, 1.5), (36, 0.8), (36, 2.5)]
)
def test_contrast_is_the_transfer_of_the_blur(periods: int, sigma: float) -> None:
    found = star_contrast(star(periods, sigma))
    assert found.place.periods == periods
    assert found.place.radius == pytest.approx(52, abs=1)
    wanted = blurred_order(periods, found.radii, sigma)
    assert float((found.contrast - wanted).abs().max()) < 0.01
    assert float((found.contrast.mean(0) - wanted).abs().max()) < 0.006


@settings(max_examples=8, deadline=None)
@given(st.floats(52, 70), st.floats(56, 72), st.floats(0, 1), st.integers(12, 40))
def test_centre_is_found(row: float, column: float, turned: float, periods: int) -> None:
    place = find_star(star(periods, 1.2, centre=(row, column), radius=48, turned=turned), periods)
    assert place.centre == pytest.approx((row, column), abs=0.05)


def test_noise_and_light_that_is_uneven() -> None:
    picture = star(24, 1.5)
    rows = torch.linspace(0.7, 1.3, picture.shape[0], dtype=torch.float64)[:, None]
    generator = torch.Generator().manual_seed(0)
    noisy = picture * rows + 0.1 * torch.randn(picture.shape, generator=generator)
    found = star_contrast(noisy, periods=24)
    wanted = blurred_order(24, found.radii, 1.5)
    off = found.contrast - wanted
    assert float(off.abs().max()) < 0.15 and abs(float(off.mean())) < 0.01
    # What the fit calls noise is what there is.
    ratio = float(off.square().mean().sqrt() / found.noise.square().mean().sqrt())
    assert 0.7 < ratio < 1.5


def test_background_takes_contrast() -> None:
    """Contrast is amplitude to mean: half as much where the mean doubles."""
    found = star_contrast(star(20, 1.0, level=0.5))
    assert found.wide == pytest.approx(0.5 * star_contrast(star(20, 1.0)).wide, rel=0.01)


def test_worst_direction_of_an_elliptical_blur() -> None:
    """Blur across the columns takes what varies along the rows: the upright spokes' contrast."""
    fine, periods, across, along = 4, 20, 3.0, 1.2
    side = 128
    sharp = siemens_star(side * fine, periods).numpy()
    picture = gaussian_filter(sharp, (along * fine, across * fine), mode="nearest")
    picture = picture.reshape(side, fine, side, fine).mean((1, 3))
    found = star_contrast(torch.from_numpy(picture))
    assert found.place.centre == pytest.approx((63.5, 63.5), abs=0.05)
    resolved = resolved_radii(found, threshold=0.1)
    radii = {
        round(float(angle)): each.radius
        for angle, each in zip(found.directions_deg, resolved, strict=True)
    }
    # Spokes at 90 deg stand upright and vary along the columns, where the blur is widest.
    assert max(radii, key=lambda angle: radii[angle]) in (90, 270)
    pixel = 1 / 12  # Variance of the mean over a cell.
    limit = 0.1 * found.wide
    for angle, variance in ((90, across**2), (270, across**2), (0, along**2), (180, along**2)):
        # The sector's cells have slightly other blurs: its middle half bounds the mean.
        sigma = math.sqrt(variance + pixel)
        wanted = next(
            r for r in np.arange(3, 60, 0.01)
            if float(blurred_order(periods, torch.tensor(r, dtype=torch.float64), sigma)) > limit
        )  # fmt: skip
        assert radii[angle] == pytest.approx(wanted, rel=0.06)
    assert radii[90] > 1.8 * radii[0]


def test_smallest_resolved_radius_is_where_the_transfer_falls() -> None:
    found = star_contrast(star(30, 2.0))
    limit = 0.1 * found.wide
    wanted = next(
        r for r in np.arange(5, 50, 0.01)
        if float(blurred_order(30, torch.tensor(r, dtype=torch.float64), 2.0)) > limit
    )  # fmt: skip
    for each in resolved_radii(found):
        assert each.radius == pytest.approx(wanted, rel=0.01)
        assert 0.5 <= each.plus_minus < 0.55 and not each.at_limit
    sharp = resolved_radii(star_contrast(star(12, 0.3)))
    assert all(each.at_limit for each in sharp)


def test_other_targets_are_refused() -> None:
    with pytest.raises(DataError, match="24 bright spokes, not 36"):
        star_contrast(star(24, 1.0), periods=36)
    generator = torch.Generator().manual_seed(1)
    noise = torch.rand(100, 100, generator=generator)
    rings = (torch.hypot(torch.arange(100)[:, None] - 50.0, torch.arange(100) - 50.0) / 3).cos()
    bars = torch.cos(torch.arange(100) / 3.0).expand(100, -1)
    for picture in (noise, rings, bars, gaussian_noise(), torch.ones(50, 50)):
        with pytest.raises(DataError, match=r"no star|no Siemens star"):
            star_contrast(picture)
    with pytest.raises(DataError, match="fewer spokes or of a larger angle"):
        star_contrast(star(20, 0.5, radius=13))
    with pytest.raises(DataError, match="even the widest spokes"):
        resolved_radii(star_contrast(star(20, 1.0)), threshold=1.2)


def gaussian_noise() -> Tensor:
    """A smooth picture without order."""
    values = np.random.default_rng(0).random((90, 110))
    return torch.from_numpy(gaussian_filter(values, 3))


def test_angles_on_a_screen() -> None:
    """Against the angle between two directions, computed from their vectors."""
    picture = FlatPicture(torch.zeros(1, 1), 1.0, (0.0, 0.0))
    for place in ((0.0, 0.0), (0.3, 0.0), (-0.2, 0.5)):
        for direction in ((1.0, 0.0), (0.0, 1.0), (0.6, -0.8)):
            length = 1e-4
            ends = [
                np.array([place[0] + s * length / 2 * direction[0],
                          place[1] + s * length / 2 * direction[1], 1.0])
                for s in (-1, 1)
            ]  # fmt: skip
            cross = np.linalg.norm(np.cross(*ends))
            wanted = math.degrees(math.atan2(cross, ends[0] @ ends[1]))
            assert picture.angle_deg(place, direction, length) == pytest.approx(wanted, rel=1e-6)


def test_target_is_as_bright_as_it_should_be() -> None:
    picture = siemens_star(400, 36)
    assert float(picture.mean()) == pytest.approx(math.pi / 4 * 0.96**2 / 2, rel=2e-3)
    assert torch.allclose(picture, picture.flip(0), atol=1e-9)
    # The spoke to the right is bright.
    assert float(picture[200, 380]) == 1
