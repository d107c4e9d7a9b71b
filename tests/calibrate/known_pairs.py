"""Photographs behind a mask of known PSF."""

from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from skimage import data
from torch import Tensor

from nolens.calibrate.known_scenes import KnownScenes
from nolens.camera import linear_from_srgb
from nolens.operators import CroppedConvolution, PixelRectangle

SENSOR = (64, 96)
PHOTOGRAPHS = (
    data.astronaut, data.coffee, data.chelsea, data.rocket, data.camera, data.coins, data.moon,
    data.immunohistochemistry,
)  # fmt: skip


def photograph(number: int, size: tuple[int, int] = SENSOR) -> Tensor:
    """Linear and grey, (1, rows, columns)."""
    pixels = torch.as_tensor(PHOTOGRAPHS[number]()).float() / 255
    grey = linear_from_srgb(pixels if pixels.ndim == 2 else pixels.mean(dim=-1))
    return nnf.interpolate(grey[None, None], size=size, mode="bilinear", antialias=True)[0]


def caustic(size: tuple[int, int], aperture: tuple[int, int], seed: int = 0) -> Tensor:
    """Bright lines of a network behind an aperture in the middle, (rows, columns), sum 1."""
    generator = torch.Generator().manual_seed(seed)
    waves = torch.fft.rfft2(torch.randn(size, generator=generator))
    frequency = torch.hypot(torch.fft.fftfreq(size[0])[:, None], torch.fft.rfftfreq(size[1])[None])
    field = torch.fft.irfft2(waves * torch.exp(-((frequency / 0.05) ** 2)), s=size)
    lines = torch.exp(-((field / (0.15 * field.std())) ** 2)) + 0.03
    open_ = torch.zeros(size)
    top, left = (size[0] - aperture[0]) // 2, (size[1] - aperture[1]) // 2
    open_[top : top + aperture[0], left : left + aperture[1]] = 1
    return lines * open_ / float((lines * open_).sum())


@dataclass(frozen=True)
class Taken:
    """Pairs, and the PSF behind them."""

    known: KnownScenes
    psf: Tensor


def take(
    count: int, *, aperture: tuple[int, int] = (40, 44), noise: float = 1e-3, seed: int = 0,
    gains: tuple[float, ...] = (), size: tuple[int, int] = SENSOR,
) -> Taken:  # fmt: skip
    """Measure so many photographs, by the plain cropped convolution; noise relative to the mean."""
    support = PixelRectangle.centred(*size, SENSOR)
    psf = caustic((SENSOR[0] + size[0], SENSOR[1] + size[1]), aperture, seed)
    camera = CroppedConvolution(psf[None], SENSOR, support)
    generator = torch.Generator().manual_seed(seed + 1)
    scenes = [photograph(number, size) for number in range(count)]
    measured = []
    for number, scene in enumerate(scenes):
        light = camera(scene) * (gains[number] if gains else 1.0)
        measured.append(
            light + noise * light.mean() * torch.randn(light.shape, generator=generator)
        )
    return Taken(KnownScenes.of(scenes, measured, support=support), psf)


def alike(one: Tensor, other: Tensor) -> float:
    """Correlation of two patterns about zero: 1 where they are the same but for a factor."""
    return float((one * other).sum() / one.norm() / other.norm())
