"""Histogram, saturation and the exposure time that would fit."""

import numpy as np
import pytest
import torch

from nolens.camera import Frame
from nolens.capture import Levels, Limits, exposure_for


def mosaic_frame(counts: torch.Tensor, black: tuple[float, ...] = (256.0,)) -> Frame:
    return Frame(counts[None].float(), ("mosaic",), "RGGB", black, 4095.0, "uint16", "test")


def test_histogram_by_colour_is_numpys() -> None:
    generator = torch.Generator().manual_seed(0)
    counts = torch.randint(100, 4200, (64, 80), generator=generator)
    levels = Levels.of(mosaic_frame(counts))
    cells = {"R": [counts[::2, ::2]], "G": [counts[::2, 1::2], counts[1::2, ::2]],
             "B": [counts[1::2, 1::2]]}  # fmt: skip
    for name, parts in cells.items():
        values = torch.cat([part.flatten() for part in parts]).clamp(256, 4095).numpy()
        expected = np.histogram(values, bins=64, range=(256, 4095))[0]
        assert np.abs(np.array(levels.histogram[name]) - expected).sum() <= 2
    assert levels.clipped_fraction == float((counts >= 4095).double().mean())
    assert levels.mean == pytest.approx((float(counts.double().mean()) - 256) / 3839)


def test_bright_is_what_all_but_one_in_a_thousand_do_not_exceed() -> None:
    counts = torch.full((100, 100), 256.0)
    counts[:1, :9] = 4095
    levels = Levels.of(mosaic_frame(counts))
    assert levels.bright < 2e-3 and levels.brightest == 1.0
    assert levels.clipped_fraction == pytest.approx(9e-4)
    counts[1, :2] = 4095
    assert Levels.of(mosaic_frame(counts)).bright == 1.0


def test_a_frame_without_white_or_colours() -> None:
    frame = Frame(torch.rand(1, 20, 20), ("grey",), None, (0.0,), None, "float32", "test")
    levels = Levels.of(frame)
    assert list(levels.histogram) == ["grey"] and sum(levels.histogram["grey"]) == 400
    assert levels.clipped_fraction == 0 and levels.brightest == pytest.approx(1.0)


@pytest.mark.parametrize("start_s", [1e-4, 0.02, 5.0])
@pytest.mark.parametrize("every_pixel", [False, True])
def test_automatic_exposure_arrives_and_stays(start_s: float, every_pixel: bool) -> None:
    generator = torch.Generator().manual_seed(1)
    rate = torch.rand((60, 60), generator=generator) * 5e4
    rate[10, 10:12] = 4e5  # Two bright points among 3600 pixels.
    limits = Limits((1e-4, 10.0), (1.0, 16.0))
    exposure_s = start_s
    for _ in range(10):
        levels = Levels.of(mosaic_frame((256 + rate * exposure_s).clamp(max=4095)))
        before, exposure_s = (
            exposure_s,
            exposure_for(levels, exposure_s, limits, every_pixel=every_pixel),
        )
    assert exposure_s == before
    level = levels.brightest if every_pixel else levels.bright
    assert 0.7 <= level <= 0.9
    assert (levels.clipped_fraction == 0) == every_pixel


def test_automatic_exposure_keeps_to_the_limits() -> None:
    limits = Limits((1e-3, 0.1), (1.0, 1.0))
    black = Levels.of(mosaic_frame(torch.full((9, 9), 256.0)))
    white = Levels.of(mosaic_frame(torch.full((9, 9), 4095.0)))
    assert exposure_for(black, 0.05, limits) == 0.1
    assert exposure_for(white, 0.004, limits) == 1e-3
