"""Regular lenslets and diffusers, against their formulas."""

import math

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from nolens.design.masks import gaussian_diffuser, lenslet_array

GRID = 1.55


@pytest.mark.parametrize(("arrangement", "radius"), [("square", 600.0), ("hexagonal", -450.0)])
def test_lenslets_are_caps_around_the_nearest_place(arrangement, radius):
    """Brute force over all places of the lattice; away from edges the blur adds −σ²/R alone."""
    pitch, blur, size = 40.0, 2.0, (121, 150)
    made = lenslet_array(
        radius_um=radius, pitch_um=pitch, arrangement=arrangement,
        smoothing_um=blur, size=size, grid_um=GRID,
    ).height_um  # fmt: skip
    assert made.shape == size
    steps = np.arange(-9, 10)
    if arrangement == "square":
        basis = np.array([[pitch, 0], [0, pitch]])
    else:
        basis = np.array([[math.sqrt(3) / 2 * pitch, pitch / 2], [0, pitch]])
    places = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2) @ basis
    rows, columns = ((np.arange(n) - (n - 1) / 2) * GRID for n in size)
    samples = np.stack(np.meshgrid(rows, columns, indexing="ij"), -1).reshape(-1, 2)
    distance, other = cKDTree(places).query(samples, k=2)[0].T
    wanted = -(distance**2) / (2 * radius) - blur**2 / radius
    inner = (other - distance > 6 * blur).reshape(size)
    assert inner.mean() > 0.2
    np.testing.assert_allclose(made.numpy()[inner], wanted.reshape(size)[inner], atol=2e-3)


def diffuser(seed: int = 0, angle_deg: float = 1.0, index_step: float = 0.47) -> torch.Tensor:
    return gaussian_diffuser(
        angle_rad=math.radians(angle_deg), feature_um=30.0, index_step=index_step,
        size=(640, 600), grid_um=GRID, seed=seed,
    ).height_um  # fmt: skip


def test_diffusers_slopes():
    """σ of the slope times Δn is the scattered light's σ, to what 640 × 600 samples show."""
    surface = torch.stack([diffuser(seed) for seed in range(4)]).double()
    wanted = math.radians(1.0) / math.sqrt(8 * math.log(2)) / 0.47
    for axis in (1, 2):
        slope = surface.diff(dim=axis) / GRID
        assert float(slope.std()) == pytest.approx(wanted, rel=0.03)
    assert float(diffuser(1, 2.0).std()) == pytest.approx(2 * float(diffuser(1).std()), rel=1e-3)


def test_diffusers_heights_are_alike_over_a_feature():
    """Autocorrelation exp(−r²/ℓ²), on a torus as the surface is."""
    fields = [torch.fft.fft2(diffuser(seed).double()) for seed in range(4)]
    correlation = torch.stack([torch.fft.ifft2(each.abs() ** 2).real for each in fields]).mean(0)
    correlation = correlation / correlation[0, 0]
    for lag in (6, 13, 19):
        wanted = math.exp(-((lag * GRID / 30.0) ** 2))
        found = float((correlation[lag, 0] + correlation[0, lag]) / 2)
        assert found == pytest.approx(wanted, abs=0.04)


def test_diffuser_scatters_by_its_angle():
    """Second moment of the light's spectrum behind the phase screen, λ f = sin θ."""
    wavelength = 0.55
    turns = torch.stack([diffuser(seed, 2.0) for seed in range(4)]).double() * 0.47 / wavelength
    field = torch.polar(torch.ones_like(turns), 2 * math.pi * turns)
    power = torch.fft.fft2(field).abs().square()
    sine = wavelength * torch.fft.fftfreq(turns.shape[1], GRID, dtype=torch.float64)
    spread = float((power * sine.square()[:, None]).sum() / power.sum()) ** 0.5
    assert math.degrees(spread) * math.sqrt(8 * math.log(2)) == pytest.approx(2.0, rel=0.04)


def test_diffuser_by_seed():
    torch.testing.assert_close(diffuser(5), diffuser(5), rtol=0, atol=0)
    assert not torch.equal(diffuser(5), diffuser(6))
    torch.testing.assert_close(diffuser(5, index_step=-0.47), diffuser(5))
