"""Scenes for the simulated camera `small`, and quick ways to have it measure them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from running import run
from torch import Tensor

from nolens.files import read_frame

QUICK = ("--camera", "small", "--wavelengths", 1, "--field-points", 1, "--angle", "15deg")
"""A scene smaller than the sensor, by the plain convolution model: a third of a second."""
PATCHES = {(230, 200, 30): (15, 45, 20, 60), (30, 60, 220): (50, 80, 65, 105)}


def scene(path: Path, opacity: int | None = None) -> Path:
    """Two patches of colour on dark, 90×120; its left half as opaque as is asked for."""
    picture = np.full((90, 120, 3), 20, np.uint8)
    for colour, (top, bottom, left, right) in PATCHES.items():
        picture[top:bottom, left:right] = colour
    if opacity is not None:
        alpha = np.full((90, 120, 1), 0, np.uint8)
        alpha[:, :60] = opacity
        picture = np.concatenate([picture, alpha], axis=-1)
    Image.fromarray(picture).save(path)
    return path


def plain(path: Path, *colour: int) -> Path:
    """One colour all over, 90×120."""
    Image.new("RGBA" if len(colour) == 4 else "RGB", (120, 90), colour).save(path)
    return path


def simulated(*arguments: object) -> dict[str, Any]:
    """What `nolens simulate --json` says; no warning is expected."""
    done = run("simulate", *arguments, "--json")
    assert done.code == 0 and done.err == "", done
    assert done.out.count("\n") == 1
    summary: dict[str, Any] = json.loads(done.out)
    return summary


def values(path: Path) -> Tensor:
    """What a file holds, (channels, height, width)."""
    return read_frame(path).counts
