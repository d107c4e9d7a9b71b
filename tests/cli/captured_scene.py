"""A captured PSF of a camera without an aperture, and raw frames of scenes before it, as files."""

from pathlib import Path

import numpy as np
import tifffile
import torch
from torch import Tensor

from nolens.camera import PsfEntry
from nolens.files import write_psfs
from nolens.operators import CroppedConvolution, PixelRectangle

SENSOR = (48, 64)
SCENE = (20, 24)
FULL = 60000.0


def wide() -> Tensor:
    """Small spots without end."""
    generator = torch.Generator().manual_seed(4)
    spots = torch.rand((1, 1, 100, 120), generator=generator)
    spots = (spots > 0.96).float() * torch.rand((1, 1, 100, 120), generator=generator)
    steps = torch.arange(-4, 5)
    line = torch.exp(-steps.square() / 2.0)
    return torch.nn.functional.conv2d(spots, (line[:, None] * line)[None, None], padding="same")[0]


def captured_set(folder: Path) -> Path:
    """A folder with the PSF as the sensor shows it."""
    entry = PsfEntry.model_validate(
        {"file": "psf.tif", "cell": "3.1 um", "channels": ("grey",), "distance": "300 mm"}
    )
    top, left = 50 - SENSOR[0] // 2, 60 - SENSOR[1] // 2
    psf = wide()[:, top : top + SENSOR[0], left : left + SENSOR[1]]
    write_psfs(folder, {entry: psf.contiguous()})
    return folder


def raw(path: Path, seed: int, sensor: tuple[int, int] = SENSOR, light: float = 1.0) -> Path:
    """16-bit frame of a few bright patches, through the whole pattern."""
    generator = np.random.default_rng(seed)
    scene = torch.full((1, *SCENE), 0.02)
    for _ in range(6):
        row, column = generator.integers(0, (SCENE[0] - 4, SCENE[1] - 4))
        scene[0, row : row + 3, column : column + 3] += float(generator.uniform(0.3, 1))
    image = CroppedConvolution(wide(), sensor, PixelRectangle.centred(*SCENE, sensor))(scene)[0]
    counts = (light * FULL * image / image.max()).round().numpy().clip(0, 65535)
    tifffile.imwrite(path, counts.astype(np.uint16), photometric="minisblack")
    return path
