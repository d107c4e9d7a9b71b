"""The sweep through the depths as an animated PNG, and the picture of the depths."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageSequence

from nolens.camera import srgb_from_linear
from nolens.files.stacks import plot_depth, write_sweep

DEPTHS, PLACES = (50e3, 80e3, 200e3, math.inf), (0.0, 0.4, 0.75, 1.0)


@pytest.mark.parametrize("channels", [1, 3])
def test_there_and_back(tmp_path: Path, channels: int) -> None:
    generator = torch.Generator().manual_seed(1)
    pages = torch.rand(4, channels, 60, 200, generator=generator)
    write_sweep(tmp_path / "sweep.png", pages, DEPTHS, PLACES, white=0.8)
    with Image.open(tmp_path / "sweep.png") as picture:
        assert picture.format == "PNG" and picture.is_animated and picture.info["loop"] == 0
        frames, pauses = [], []
        for frame in ImageSequence.Iterator(picture):
            frames.append(np.asarray(frame.convert("RGB"))[:60])
            pauses.append(frame.info["duration"])
    order = [0, 1, 2, 3, 2, 1]
    assert len(frames) == len(order) and pauses[0] == pauses[3] > pauses[1]
    for frame, number in zip(frames, order, strict=True):
        shown = (srgb_from_linear(pages[number] / 0.8) * 255).round().byte().expand(3, -1, -1)
        assert np.array_equal(frame, shown.movedim(0, -1).numpy())


def test_the_mark_moves_with_the_depth(tmp_path: Path) -> None:
    pages = torch.zeros(4, 1, 40, 300)
    write_sweep(tmp_path / "sweep.png", pages, DEPTHS, PLACES, white=1.0)
    with Image.open(tmp_path / "sweep.png") as picture:
        frames = [np.asarray(each.convert("L"), float) for each in ImageSequence.Iterator(picture)]
    columns = []
    for frame in frames[:4]:
        mark = frame[40:, 70:] > 200
        columns.append(float(np.nonzero(mark)[1].mean()))
    share = (np.array(columns) - columns[0]) / (columns[3] - columns[0])
    assert np.allclose(share, PLACES, atol=0.01)


def test_small_and_single(tmp_path: Path) -> None:
    write_sweep(tmp_path / "sweep.png", torch.ones(1, 1, 5, 7), (50e3,), (0.0,), white=1.0)
    with Image.open(tmp_path / "sweep.png") as picture:
        assert picture.width >= 100 and picture.height > 5


def test_picture_of_depths(tmp_path: Path) -> None:
    """Near is yellow, far is purple, and what is not known is grey."""
    per_m = torch.full((40, 90), 20.0)
    per_m[:, 30:] = 0.0
    confidence = torch.ones(40, 90)
    confidence[:, 60:] = 0.0
    plot_depth(tmp_path / "depth.png", per_m, confidence, (50e3, 100e3, math.inf))
    with Image.open(tmp_path / "depth.png") as picture:
        pixels = np.asarray(picture.convert("RGB")).reshape(-1, 3).astype(int)
    shares = [
        (np.abs(pixels - colour).max(axis=1) < 12).mean()
        for colour in ((253, 231, 37), (68, 1, 84), (191, 191, 191))
    ]
    assert all(share > 0.1 for share in shares), shares
