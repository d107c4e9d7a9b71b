"""Counts follow the photon transfer of the sensor."""

import pytest
import torch

from nolens.twin import Sensor, expose

SIDE = 400


def flat(red: float, green: float, blue: float) -> torch.Tensor:
    return torch.tensor([red, green, blue])[:, None, None].expand(3, SIDE, SIDE).contiguous()


@pytest.mark.parametrize("fill", [0.05, 0.3, 0.8])
def test_mean_and_variance_follow_photon_transfer(fill: float) -> None:
    sensor = Sensor()
    counts = expose(flat(1, 1, 1), sensor, fill=fill, seed=1).double()
    electrons, gain = fill * sensor.clip_electrons, sensor.counts_per_electron
    signal = float(counts.mean()) - sensor.black_counts
    assert signal == pytest.approx(gain * electrons, rel=2e-3)
    # Shot noise, read noise, and the rounding to whole counts.
    expected = gain**2 * (electrons + sensor.read_noise_electrons**2) + 1 / 12
    assert float(counts.var()) == pytest.approx(expected, rel=0.02)


def test_dark_pixels_have_read_noise_around_black() -> None:
    sensor = Sensor()
    counts = expose(flat(0, 1, 0), sensor, fill=0.5, seed=2).double()
    for dark in (counts[::2, ::2], counts[1::2, 1::2]):
        assert float(dark.mean()) == pytest.approx(sensor.black_counts, abs=0.03)
        expected = (sensor.counts_per_electron * sensor.read_noise_electrons) ** 2 + 1 / 12
        assert float(dark.var()) == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize("mosaic", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaic_order(mosaic: str) -> None:
    levels = {"R": 0.25, "G": 1.0, "B": 0.5}
    sensor = Sensor(mosaic=mosaic)
    counts = expose(flat(*(levels[each] for each in "RGB")), sensor, fill=0.8, seed=3).double()
    assert counts.shape == (2 * SIDE, 2 * SIDE)
    for cell, colour in enumerate(mosaic):
        plane = counts[cell // 2 :: 2, cell % 2 :: 2] - sensor.black_counts
        full = 0.8 * sensor.clip_electrons * sensor.counts_per_electron
        assert float(plane.mean()) == pytest.approx(levels[colour] * full, rel=5e-3), colour


def test_clipping() -> None:
    sensor = Sensor()
    counts = expose(flat(1, 1, 1), sensor, fill=3.0, seed=4)
    clip = sensor.black_counts + sensor.counts_per_electron * sensor.clip_electrons
    assert counts.dtype == torch.int32
    assert counts.unique().tolist() == [min(round(clip), sensor.white_counts)]
    small = Sensor(bits=8, black_counts=16)
    assert small.white_counts == 255
    assert expose(flat(1, 1, 1), small, fill=1.0, seed=4).unique().tolist() == [255]
    noisy = Sensor(black_counts=0, read_noise_electrons=30.0)
    assert int(expose(flat(0, 1, 0), noisy, fill=0.1, seed=4).min()) == 0


def test_brightest_pixel_takes_the_fill_whatever_the_unit() -> None:
    light = torch.rand(3, 8, 8, generator=torch.manual_seed(5))
    sensor = Sensor()
    first = expose(light, sensor, fill=0.9, seed=6)
    assert torch.equal(expose(light * 1024, sensor, fill=0.9, seed=6), first)
    expected = sensor.black_counts + 0.9 * sensor.clip_electrons * sensor.counts_per_electron
    assert float(first.max()) == pytest.approx(expected, rel=0.05)


def test_seed() -> None:
    light = flat(1, 0.5, 0.2)[:, :20, :20]
    first = expose(light, Sensor(), fill=0.9, seed=7)
    assert torch.equal(expose(light, Sensor(), fill=0.9, seed=7), first)
    assert not torch.equal(expose(light, Sensor(), fill=0.9, seed=8), first)
    state = torch.get_rng_state()
    expose(light, Sensor(), fill=0.9, seed=7)
    assert torch.equal(torch.get_rng_state(), state)
