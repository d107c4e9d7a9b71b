"""How fine a detail a PSF carries, against blurs whose transfer is known."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from nolens.solvers.development import finest_detail


def blurred_spots(sigma: float, size: tuple[int, int] = (300, 380)) -> torch.Tensor:
    """A few hundred spots of Gaussian shape: transfer exp(−2π²σ²f²) beside that of points."""
    generator = torch.Generator().manual_seed(4)
    points = (torch.rand(size, generator=generator) > 0.997).double()
    down = torch.fft.fftfreq(size[0], dtype=torch.float64)[:, None]
    right = torch.fft.rfftfreq(size[1], dtype=torch.float64)
    transfer = torch.exp(-2 * (math.pi * sigma) ** 2 * (down.square() + right.square()))
    spots = torch.fft.irfft2(torch.fft.rfft2(points) * transfer, s=size)
    return spots.clamp_min(0).float()[None]


@given(st.floats(1.0, 9.0))
def test_gaussian_spots(sigma: float) -> None:
    # The transfer is 1 % at f = √(ln 100 / 2) / (πσ); rings vary about that by a tenth.
    expected = math.sqrt(math.log(100) / 2) / (math.pi * sigma)
    assert finest_detail(blurred_spots(sigma)) == pytest.approx(min(0.5, expected), rel=0.12)


def test_points_and_noise_are_carried_to_the_last_cell() -> None:
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand((1, 120, 150), generator=generator)
    assert finest_detail(noise) == 0.5
    assert finest_detail(blurred_spots(0.3)) == 0.5


def test_noise_of_the_measurement_is_no_detail() -> None:
    psf = blurred_spots(4.0)
    generator = torch.Generator().manual_seed(1)
    noisy = psf + 2e-3 * float(psf.max()) * torch.randn(psf.shape, generator=generator)
    assert finest_detail(noisy.clamp_min(0)) <= finest_detail(psf) < 0.14


def test_the_finest_channel_counts() -> None:
    fine = blurred_spots(2.2)
    assert finest_detail(torch.cat([blurred_spots(6.0), fine])) == finest_detail(fine) < 0.3


@pytest.mark.parametrize("size", [(5, 400), (15, 15), (1, 1)])
def test_too_small_to_tell(size: tuple[int, int]) -> None:
    assert finest_detail(torch.ones(1, *size)) == 0.5
