"""Focal stacks and depth maps as TIFF, read again by another library."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import tifffile
import torch
from PIL import Image, ImageSequence

from nolens.errors import FileError
from nolens.files.stacks import depth_text, write_depths, write_stack

DEPTHS = (80e3, 123.456e3, 2e6, math.inf)


@pytest.mark.parametrize("channels", [1, 3])
def test_pages_and_depths(tmp_path: Path, channels: int) -> None:
    generator = torch.Generator().manual_seed(1)
    pages = 2.5 * torch.rand(4, channels, 9, 13, generator=generator)
    path = tmp_path / "stack.tif"
    write_stack(path, pages, DEPTHS, white=2.0)
    with tifffile.TiffFile(path) as file:
        found = file.asarray().reshape(4, channels, 9, 13)
        told = file.imagej_metadata
        assert file.is_imagej and told is not None
    wanted = (pages / 2.0).clamp(0, 1) * 65535
    assert np.abs(found - wanted.numpy()).max() <= 0.51
    assert (found == 65535).sum() >= int((pages >= 2.0).sum()) > 0
    assert told["slices"] == 4 and told["depths_mm"] == "80,123.456,2000,infinity"
    assert told["linear"] == "true" or told["linear"] is True
    assert float(told["per_count"]) == pytest.approx(2.0 / 65535)
    names = ["8 cm", "12.3 cm", "2 m", "infinity"]
    if channels == 1:
        assert told["Labels"] == names
        with Image.open(path) as picture:
            frames = [np.asarray(frame) for frame in ImageSequence.Iterator(picture)]
        assert len(frames) == 4 and np.array_equal(frames[2], found[2, 0])
    else:
        assert told["channels"] == 3 and told["mode"] == "composite"
        assert told["Labels"] == [f"{name} {colour}" for name in names for colour in "RGB"]


def test_depths_in_mm(tmp_path: Path) -> None:
    per_m = torch.tensor([[12.5, 5.0, 0.0], [-0.1, 100.0, 0.5]])
    write_depths(tmp_path / "depth.tif", per_m)
    with tifffile.TiffFile(tmp_path / "depth.tif") as file:
        found = file.asarray()
        told = json.loads(file.pages[0].description)
    assert found.dtype == np.float32 and told == {"quantity": "depth", "unit": "mm"}
    assert np.allclose(found, [[80, 200, np.inf], [np.inf, 10, 2000]])


@pytest.mark.parametrize(
    ("depth_um", "text"),
    [
        (8e3, "8 mm"),
        (80e3, "8 cm"),
        (81.25e3, "8.12 cm"),
        (1.256e6, "1.26 m"),
        (math.inf, "infinity"),
    ],
)
def test_depths_as_people_say_them(depth_um: float, text: str) -> None:
    assert depth_text(depth_um) == text


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(FileError, match="cannot write"):
        write_depths(tmp_path / "none" / "depth.tif", torch.ones(2, 2))
