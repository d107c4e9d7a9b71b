"""Spectral magnitude and sparsity of patterns with known ones."""

import math

import pytest
import torch

from nolens.errors import DataError
from nolens.evaluate import sparsity, spectral_magnitude


def spots(side: int, deviation: float, count: int, seed: int) -> torch.Tensor:
    """Gaussian spots in random places, through their spectrum."""
    generator = torch.Generator().manual_seed(seed)
    points = torch.zeros(side, side)
    for row, column in torch.randint(side, (count, 2), generator=generator).tolist():
        points[row, column] += 1
    frequency = torch.fft.fftfreq(side)
    blur = torch.exp(-2 * (math.pi * deviation * frequency) ** 2)
    return torch.fft.ifft2(torch.fft.fft2(points) * blur[:, None] * blur).real


@pytest.mark.parametrize("per_mm", [15.0, 30.0, 60.0])
def test_one_gaussian_spot(per_mm):
    """√a exp(−2π²σ²f²), σ 6.2 um on 256² cells of 3.1 um; the ring has a width of 4 per mm."""
    pattern = spots(256, 2.0, 1, 0)
    side_mm = 256 * 3.1e-3
    expected = side_mm * math.exp(-2 * (math.pi * 6.2e-3 * per_mm) ** 2)
    assert spectral_magnitude(pattern, 3.1, per_mm) == pytest.approx(expected, rel=0.06)


def test_random_spots_have_the_same_transfer_in_any_area():
    """N spots to the mm²: 1/√N times that of one spot, whatever the area, to the luck of places."""
    whole = spots(768, 2.0, 2000, 1)
    per_mm2 = 2000 / (768 * 3.1e-3) ** 2
    expected = math.exp(-2 * (math.pi * 6.2e-3 * 30) ** 2) / math.sqrt(per_mm2)
    assert spectral_magnitude(whole, 3.1, 30.0) == pytest.approx(expected, rel=0.08)
    part = whole[100:484, 200:584]
    assert spectral_magnitude(part, 3.1, 30.0) == pytest.approx(expected, rel=0.15)


def test_scale_does_not_matter():
    pattern = spots(128, 2.0, 40, 2)
    assert spectral_magnitude(7 * pattern, 3.1, 30.0) == pytest.approx(
        spectral_magnitude(pattern, 3.1, 30.0), rel=1e-4
    )


@pytest.mark.parametrize("lit", [1, 8, 64])
def test_sparsity_is_the_share_without_light(lit):
    pattern = torch.zeros(64, 64)
    pattern[:, :lit] = 3.0
    assert sparsity(pattern) == pytest.approx(1 - lit / 64)


@pytest.mark.parametrize(("per_mm", "words"), [(200.0, "choose up to 161"), (30.0, "dark")])
def test_what_cannot_be_measured(per_mm, words):
    pattern = torch.zeros(64, 64) if words == "dark" else spots(64, 2.0, 10, 3)
    with pytest.raises(DataError, match=words):
        spectral_magnitude(pattern, 3.1, per_mm)
    with pytest.raises(DataError, match="dark"):
        sparsity(torch.zeros(4, 4))
