"""A simulated camera of 48×64 cells and the files it writes."""

from dataclasses import dataclass
from pathlib import Path

import imagecodecs
import numpy as np
import tifffile
import torch
from PIL import Image
from torch import Tensor

from nolens.camera import preset, preset_text
from nolens.evaluate import psnr, scale_fit
from nolens.files import write_dng
from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.twin import expose, mosaic

SENSOR = (48, 64)
SCENE = (24, 32)
SUPPORT = "24x32"
BLACK, WHITE = 256, 4095
QUICK = ("--tau", 8e-3, "--iterations", 64)
"""The weight that is chosen for its frames, and the iterations that bring 40 dB of the 47."""


def truth() -> Tensor:
    """A scene that looks different in each channel, and when turned, flipped or shifted."""
    scene = torch.full((3, *SCENE), 0.05)
    scene[0, 3:10, 4:13] = 1.0
    scene[1, 8:20, 17:27] = 0.8
    scene[2, 14:22, 5:11] = 0.9
    scene[:, 2:6, 22:29] += 0.4
    scene[:2, 16:18, 8:24] += 0.3
    return scene.clamp(0, 1)


def spots(cells: tuple[int, int] = SENSOR, seed: int = 3) -> Tensor:
    """PSF of a few small spots, alike but not the same in the three channels."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[: cells[0], : cells[1]]
    plane = np.zeros((3, *cells))
    for _ in range(14):
        row, column = generator.uniform(0.15, 0.85, 2) * cells
        for channel in range(3):
            width = 0.7 + 0.15 * channel
            squared = (rows - row) ** 2 + (columns - column) ** 2
            plane[channel] += generator.uniform(0.6, 1) * np.exp(-squared / (2 * width**2))
    return torch.from_numpy(plane).float()


def measured(
    psf: Tensor, scene: Tensor | None = None, support: PixelRectangle | None = None
) -> Tensor:
    """Light on the sensor, without noise."""
    support = support or PixelRectangle.centred(*SCENE, SENSOR)
    return CroppedConvolution(psf, SENSOR, support)(truth() if scene is None else scene).clamp_min(
        0
    )


def as_counts(light: Tensor, seed: int, noise: float = 2.0) -> Tensor:
    """Whole counts of 12 bits above black, with Gaussian noise, for files without a mosaic."""
    generator = torch.Generator().manual_seed(seed)
    signal = 0.9 * (WHITE - BLACK) * light / light.max()
    noisy = BLACK + signal + noise * torch.randn(light.shape, generator=generator)
    return noisy.round().clamp(0, WHITE)


def save(path: Path, values: Tensor) -> Path:
    """Write (channels, height, width) in the format of the suffix: 16 bits, or float for npy."""
    array = values.movedim(0, -1).numpy()
    array = array[..., 0] if array.shape[-1] == 1 else array
    if path.suffix == ".npy":
        np.save(path, array.astype(np.float32))
    elif path.suffix == ".tif":
        kind = "rgb" if array.ndim == 3 else "minisblack"
        tifffile.imwrite(path, array.astype(np.uint16), photometric=kind)
    elif array.ndim == 2:
        Image.fromarray(array.astype(np.uint16)).save(path)
    else:
        path.write_bytes(imagecodecs.png_encode(array.astype(np.uint16, order="C")))
    return path


@dataclass(frozen=True)
class Camera:
    """Its folder holds raw.dng and psf.dng, as a camera writes them."""

    folder: Path
    raw: Path
    psf: Path

    @classmethod
    def make(cls, folder: Path) -> "Camera":
        psf = spots()
        return cls(
            folder,
            expose_dng(folder / "raw.dng", measured(psf), seed=1),
            expose_dng(folder / "psf.dng", psf, seed=2),
        )


def expose_dng(path: Path, light: Tensor, seed: int, fill: float = 0.9) -> Path:
    sensor = preset("small").sensor
    pixels = light.repeat_interleave(2, dim=-2).repeat_interleave(2, dim=-1)
    image = mosaic(pixels, sensor.mosaic)
    counts = expose(image * (fill * sensor.full_well_electrons / image.max()), sensor, seed=seed)
    write_dng(path, counts, pattern=sensor.mosaic, black=BLACK, white=WHITE)
    return path


def quality(picture: Tensor, scene: Tensor | None = None) -> float:
    """PSNR in dB after one scale factor over all channels."""
    scene = truth() if scene is None else scene
    return psnr(scale_fit(picture, scene), scene, float(scene.max()))


def little_twin(folder: Path) -> Path:
    """Description of a simulated camera of 96×128 pixels, made in a moment."""
    text = preset_text("small")
    for old, new in (
        ("rows = 256", "rows = 96"), ("columns = 320", "columns = 128"),
        ('overhang = "0.6 mm"', 'overhang = "0.1 mm"'),
        ('width = "0.25 mm"', 'width = "0.1 mm"'), ('height = "0.2 mm"', 'height = "0.08 mm"'),
    ):  # fmt: skip
        assert old in text
        text = text.replace(old, new)
    path = folder / "camera.toml"
    path.write_text(text)
    return path
