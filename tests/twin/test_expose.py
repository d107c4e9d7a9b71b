"""Counts of a frame: photon transfer, saturation, seeds, the order of the mosaic."""

from typing import Any

import pytest
import torch
from cameras import GREEN, WHITE, cropped, flattened, twin_of
from torch import Tensor

from nolens.camera import Sensor, preset
from nolens.twin import Plane, Twin, expose, irradiate, mosaic, photocurrents, render_planes

SIDE = 800


def _sensor(**changes: Any) -> Sensor:
    return preset("paper").sensor.model_copy(update=changes)


def _flat(electrons: float) -> Tensor:
    return torch.full((SIDE, SIDE), float(electrons))


@pytest.mark.parametrize("gain", [1.0, 4.0])
@pytest.mark.parametrize("electrons", [0.0, 30.0, 500.0, 1700.0])
def test_mean_and_variance_follow_photon_transfer(electrons, gain):
    """Mean K·N above black, variance K²(N + r²) and that of rounding; K counts to the electron."""
    sensor = _sensor(gain=gain)
    counts = expose(_flat(electrons), sensor, seed=1).double()
    to_counts = gain * sensor.counts_per_electron
    signal = float(counts.mean()) - sensor.black_counts
    assert signal == pytest.approx(to_counts * electrons, rel=0.002, abs=0.02 * gain)
    expected = to_counts**2 * (electrons + sensor.read_noise_electrons**2) + 1 / 12
    assert float(counts.var()) == pytest.approx(expected, rel=0.02)


def test_every_pixel_has_its_own_mean():
    electrons = torch.tensor([[0.0, 100.0], [1000.0, 4000.0]])
    counts = expose(electrons.repeat(200, 200), _sensor(), seed=2).double()
    for row in (0, 1):
        for column in (0, 1):
            mean = float(counts[row::2, column::2].mean())
            expected = 256 + 0.47 * float(electrons[row, column])
            assert mean == pytest.approx(expected, abs=0.5)


def test_noise_of_pixels_is_independent():
    noise = expose(_flat(1000), _sensor(), seed=3).double()
    noise -= noise.mean()
    for neighbour in (noise.roll(1, 0), noise.roll(1, 1)):
        assert abs(float((noise * neighbour).mean() / noise.square().mean())) < 0.01


def test_a_full_pixel_below_the_largest_count():
    """8180 electrons of 0.3 counts: full at 2710 of 4095, with read noise and no shot noise."""
    sensor = _sensor(counts_per_electron=0.3)
    assert sensor.clip_electrons == 8180
    counts = expose(_flat(20000), sensor, seed=4).double()
    assert float(counts.mean()) == pytest.approx(256 + 0.3 * 8180, abs=0.05)
    assert float(counts.var()) == pytest.approx(0.3**2 * 3**2 + 1 / 12, rel=0.02)


def test_the_largest_count_below_a_full_pixel():
    """At gain 2 the counts end at 4084 electrons, of 8180 that the pixel holds."""
    sensor = _sensor(gain=2.0)
    assert sensor.clip_electrons == pytest.approx((4095 - 256) / 0.94)
    counts = expose(_flat(6000), sensor, seed=5)
    assert counts.dtype == torch.int32
    assert counts.unique().tolist() == [4095]
    small = _sensor(bits=8, black_counts=16.0)
    assert expose(_flat(6000), small, seed=5).unique().tolist() == [255]


def test_counts_are_never_negative():
    counts = expose(_flat(0), _sensor(black_counts=0.0, read_noise_electrons=30.0), seed=6)
    assert int(counts.min()) == 0
    # Half of the Gaussian is cut off, and rounding takes what is below 1/2.
    assert float((counts == 0).double().mean()) == pytest.approx(0.514, abs=0.005)


def test_seed():
    light = 500 * torch.rand(40, 50, generator=torch.Generator().manual_seed(0))
    first = expose(light, _sensor(), seed=7)
    assert torch.equal(expose(light, _sensor(), seed=7), first)
    assert not torch.equal(expose(light, _sensor(), seed=8), first)


def test_the_global_generator_and_the_light_stay_as_they_are():
    light = torch.full((20, 20), 300.0)
    state = torch.get_rng_state()
    expose(light, _sensor(), seed=9)
    assert torch.equal(torch.get_rng_state(), state)
    assert torch.equal(light, torch.full((20, 20), 300.0))


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaic_order(pattern):
    planes = torch.arange(3.0)[:, None, None] + torch.arange(24.0).reshape(1, 4, 6) / 100
    got = mosaic(planes, pattern)
    for row in range(4):
        for column in range(6):
            colour = pattern[2 * (row % 2) + column % 2]
            assert got[row, column] == planes["RGB".index(colour), row, column]


def test_without_a_mosaic_the_one_plane_is_the_frame():
    plane = torch.rand(1, 3, 5)
    assert torch.equal(mosaic(plane, "none"), plane[0])


# --- From a scene's luminance to counts ------------------------------------------------------


@pytest.fixture(scope="module")
def bare() -> Twin:
    """A camera without a mask: a constant scene lights all of it evenly."""
    return twin_of(flattened(cropped(64, 96)))


@pytest.fixture(scope="module")
def evenly_lit(bare: Twin) -> Tensor:
    field, seen = render_planes(bare, (Plane(torch.ones(3, 8, 8), 15.0, 300e3),))
    return irradiate(bare, field, seen, field_points=1, light=GREEN, wavelengths=1).light


def test_photocurrents_are_those_of_a_pixels_area(bare):
    currents = photocurrents(bare, WHITE, 80.0)
    assert currents.shape == (3,)
    for channel, name in enumerate("RGB"):
        expected = WHITE.electrons(bare.quantum_efficiency, name, 80.0) * (1.55e-6) ** 2
        assert float(currents[channel]) == pytest.approx(expected, rel=1e-6)


def test_counts_double_with_exposure_until_they_clip(bare, evenly_lit):
    sensor = bare.camera.sensor
    currents = photocurrents(bare, WHITE, 250.0)
    colours = mosaic(currents[:, None, None].expand(-1, 64, 96), sensor.mosaic)
    brightest = float((evenly_lit * colours).max())  # Electrons in a second.

    def signal(seconds: float) -> Tensor:
        counts = expose(evenly_lit * colours * seconds, sensor, seed=1).double()
        assert int(counts.max()) <= sensor.white_counts
        return (
            torch.stack([counts[row::2, column::2].mean() for row in (0, 1) for column in (0, 1)])
            - sensor.black_counts
        )

    time = 0.4 * sensor.clip_electrons / brightest
    once, twice = signal(time), signal(2 * time)
    assert (once > 50).all()
    torch.testing.assert_close(twice, 2 * once, rtol=0.01, atol=0.0)
    # Of its electrons as many counts as the description says.
    green = float(evenly_lit[0::2, 1::2].mean()) * float(currents[1]) * time
    assert float(once[1]) == pytest.approx(sensor.counts_per_electron * green, rel=0.01)
    # At four times the exposure the brightest colour is clipped, and no longer doubles.
    clipped = signal(4 * time)
    assert float(clipped.max()) == sensor.white_counts - sensor.black_counts
    assert float(clipped.max()) < 3 * float(once.max())


def test_exposure_of_the_paper_is_of_the_right_size():
    """A screen of some 200 cd/m² that fills 60° took the paper 40 to 70 ms, below saturation."""
    twin = twin_of(flattened(cropped(64, 64)))
    field, seen = render_planes(twin, (Plane(torch.ones(3, 3, 4), 60.0, 300e3),))
    light = float((seen[0].radiance[1] * field.solid_angle() * field.vignetting()).sum())
    current = light * float(photocurrents(twin, WHITE, 200.0).max())
    seconds = twin.camera.sensor.clip_electrons / current
    assert 0.01 < seconds < 0.3


def test_the_pixels_pitch_is_what_counts():
    """Twice the pitch: four times the electrons."""
    cameras = cropped(64, 64), cropped(64, 64, pitch="3.1 um")
    fine, large = (photocurrents(twin_of(flattened(each)), WHITE, 1.0) for each in cameras)
    torch.testing.assert_close(large, 4 * fine)
