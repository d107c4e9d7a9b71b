"""The usable band ends where a known spectrum meets known noise."""

import math

import pytest
import torch

from nolens.calibrate.point_psf import usable_band

CELL_UM = 3.1


def picture(width_cells: float, noise: float) -> tuple[torch.Tensor, torch.Tensor]:
    """White light blurred by a Gaussian, with a mean power spectrum that is known; and noise."""
    generator = torch.Generator().manual_seed(1)
    white = torch.randn(300, 340, generator=generator, dtype=torch.float64)
    rows, columns = (torch.fft.fftfreq(n, dtype=torch.float64) for n in white.shape)
    squared = rows[:, None].square() + columns.square()
    blur = torch.exp(-2 * (math.pi * width_cells) ** 2 * squared)
    pattern = torch.fft.ifft2(torch.fft.fft2(white) * blur).real
    return pattern.float(), noise * torch.randn(white.shape, generator=generator)


@pytest.mark.parametrize("noise", [1e-1, 1e-2, 1e-3])
@pytest.mark.parametrize("width", [1.0, 2.0])
@pytest.mark.parametrize("seen", [True, False], ids=["noise-seen", "noise-foretold"])
def test_where_signal_meets_noise(noise: float, width: float, seen: bool) -> None:
    """exp(-4 (pi w f)²) = noise²."""
    pattern, grain = picture(width, noise)
    other = picture(width, noise)[1].roll(40, 0)
    variance = torch.full(pattern.shape, noise**2)
    band = usable_band(pattern + grain, CELL_UM, variance=variance, noise=other if seen else None)
    meets = math.sqrt(-math.log(noise**2)) / (2 * math.pi * width)
    expected = min(meets, 0.5) / (CELL_UM * 1e-3)
    assert band.usable_per_mm == pytest.approx(expected, rel=0.08)
    flat = [each for each, at in zip(band.noise, band.per_mm, strict=True) if at > 20]
    ring = max(flat) / min(flat)
    assert ring == pytest.approx(1, abs=0.4 if seen else 1e-6)


def test_noise_alone_has_no_band() -> None:
    _, grain = picture(1.0, 1.0)
    found = usable_band(grain, CELL_UM, variance=torch.ones(grain.shape))
    assert found.usable_per_mm < 10
