"""Frames are averaged, their noise is told, and what is not alike is refused."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from nolens.calibrate.exposures import Noise, noise_of_samples, noise_squares
from nolens.calibrate.frames import FrameMean, black_plane
from nolens.camera import Frame
from nolens.errors import DataError


def frame(values: Tensor, **more: object) -> Frame:
    base = Frame(values, ("mosaic",), "RGGB", (64.0,), 4095.0, "uint16", "a.dng")
    return replace(base, **more)  # type: ignore[arg-type]


def noisy(signal: Tensor, gain: float, read: float, seed: int) -> Tensor:
    """Counts of shot and read noise, above a black level of 64."""
    generator = torch.Generator().manual_seed(seed)
    electrons = torch.poisson(signal / gain, generator=generator)
    return (64 + gain * electrons + read * torch.randn(signal.shape, generator=generator)).round()


@settings(max_examples=8)
@given(gain=st.floats(0.2, 1.5), read=st.floats(1, 6), count=st.integers(2, 5))
def test_noise_of_frames(gain: float, read: float, count: int) -> None:
    # Read noise is an intercept below shot noise: with fewer pixels its spread is the tolerance's.
    signal = torch.linspace(0, 1500, 400)[None, :, None].expand(1, 400, 480).clone()
    mean = FrameMean(frame(noisy(signal, gain, read, 0)))
    for seed in range(1, count):
        mean.add(frame(noisy(signal, gain, read, seed)))
    halves = mean.half_difference()
    assert halves is not None
    found = noise_of_samples([mean.mean - 64], [halves.square()], Noise(1.0, 0.0, "frames"))
    assert found.counts_per_electron == pytest.approx(gain, rel=0.06)
    assert found.read_variance == pytest.approx(read**2 + 1 / 12, rel=0.2, abs=0.5 * gain + 0.3)
    assert float((mean.mean - 64 - signal).double().mean()) == pytest.approx(0, abs=1)


def test_noise_of_one_picture() -> None:
    rows, columns = (torch.linspace(0, 8, n) for n in (300, 320))
    signal = 600 * (1.2 + torch.sin(rows)[:, None] * torch.cos(columns))
    plane = noisy(signal, 0.5, 3.0, 4) - 64
    squares = noise_squares(plane)
    around = torch.nn.functional.avg_pool2d(plane[None, None], 3, 1)[0, 0]
    found = noise_of_samples([around], [squares], Noise(1.0, 0.0, "picture"))
    assert found.counts_per_electron == pytest.approx(0.5, rel=0.08)
    for level in (200, 600, 1200):
        variance = float(found.variance(torch.tensor(float(level))))
        assert variance == pytest.approx(9.1 + 0.5 * level, rel=0.07)


def test_pixels_that_clip_in_any_frame() -> None:
    counts = torch.arange(64.0).reshape(1, 8, 8) + 1000
    bright = counts.clone()
    bright[0, 2, 3] = 4095
    mean = FrameMean(frame(counts))
    mean.add(frame(bright))
    assert mean.clipped.nonzero().tolist() == [[0, 2, 3]]
    assert mean.count == 2 and float(mean.mean[0, 2, 3]) == (1019 + 4095) / 2


def test_white_that_nobody_stated_is_seen() -> None:
    """Twelve bits in a file of sixteen: very many pixels have just the largest count."""
    generator = torch.Generator().manual_seed(0)
    counts = (500 + 300 * torch.randn(1, 100, 100, generator=generator)).round().clamp(0, 1000)
    plain = FrameMean(frame(counts, white=65535.0))
    assert plain.white == 1000
    assert float(plain.clipped.double().mean()) == pytest.approx(0.048, abs=0.01)
    below = FrameMean(frame(counts.clamp(max=1e4) * (counts < 1000), white=65535.0))
    assert below.white == 65535 and not below.clipped.any()


def test_brightness_of_each_frame() -> None:
    signal = torch.linspace(10, 2000, 400).reshape(1, 20, 20)
    mean = FrameMean(frame((64 + signal).round()))
    mean.add(frame((64 + 0.97 * signal).round()))
    assert mean.alike and mean.uneven == pytest.approx(0.03, abs=1e-3)
    mean.add(frame((64 + 0.9 * signal).round()))
    assert not mean.alike and mean.uneven == pytest.approx(0.1, abs=1e-3)


def test_black_levels_of_a_mosaic() -> None:
    four = frame(torch.zeros(1, 6, 8), black=(1.0, 2, 3, 4))
    plane = black_plane(four)
    assert plane[0, :2, :2].tolist() == [[1, 2], [3, 4]] and plane.shape == (1, 6, 8)
    assert torch.equal(plane[:, 2:4, 4:6], plane[:, :2, :2])
    colours = Frame(torch.zeros(3, 6, 8), ("R", "G", "B"), None, (1.0, 2, 3), 1.0, "uint16", "a")
    assert black_plane(colours).flatten().tolist() == [1, 2, 3]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"counts": torch.zeros(1, 8, 10)}, "8×10 pixels"),
        ({"mosaic": "BGGR"}, "colour mosaic BGGR"),
        ({"channels": ("grey",), "mosaic": None}, r"\(grey\)"),
        ({"black": (65.0,)}, "black 65"),
        ({"white": 1023.0}, "white 1023"),
        ({"counts": torch.full((1, 8, 8), torch.nan)}, "NaN"),
    ],
)
def test_frames_of_another_camera_are_refused(more: dict[str, object], words: str) -> None:
    mean = FrameMean(frame(torch.zeros(1, 8, 8)))
    with pytest.raises(DataError, match=words):
        mean.add(frame(torch.zeros(1, 8, 8), source="b.dng", **more))
