"""Cameras to train on: random ones, and one whose PSFs are known."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import FieldPsf, Sensor
from nolens.camera.field_psf import around_middle
from nolens.training.psfs import altered_psf, random_psf

Size = tuple[int, int]

SMALLEST_PSF = 32
"""Pixels along the shorter side of a camera's PSF."""
_ELECTRONS = 300.0, 200_000.0
"""In the brightest pixel of a random camera."""
_READ_ELECTRONS = 3.0
_OF_KNOWN = 0.5
_FILLS = 0.02, 0.9
"""Of the brightest pixel of a known sensor."""
_LEAST_LIGHT = 0.5
"""In a part of a PSF, over that in its middle."""
_TRIED = 8
_OFF = 0.6
"""Fraction of the views whose PSF is not that of the model."""
_OVER_THE_FIELD, _ALTERED = 0.8, 0.35
"""The same where PSFs over the field are known, and the fraction whose model is altered, too."""
_TINT = 0.1
"""Deviation of the logarithm of a channel's brightness, as lights differ."""
_GREENS = 2.0
"""Green pixels in a superpixel, where the others have one."""


@dataclass(frozen=True)
class CameraView:
    """A camera, as it takes one small scene.

    Parameters
    ----------
    psf
        Of the model, (channels, height, width), each channel of sum 1.
    light
        PSFs that the light really comes by; places in pixels of the measurement.
    gains
        Brightness of each channel, (channels, 1, 1).
    electrons
        In the brightest pixel.
    read_electrons
        Standard deviation of the read noise of a pixel.
    pixels
        Of the sensor in one of the measurement, (channels, 1, 1).
    """

    psf: Tensor
    light: FieldPsf
    gains: Tensor
    electrons: float
    read_electrons: float
    pixels: Tensor


class TrainingCamera(Protocol):
    """What measurements to train on are simulated with."""

    def view(self, random: np.random.Generator, side: int, sensor: Size) -> CameraView:
        """How it takes a scene of `side` pixels with a sensor of (height, width)."""


@dataclass(frozen=True)
class RandomCameras:
    """Another camera for each scene, of PSFs of many kinds, behind a colour mosaic.

    Parameters
    ----------
    known
        Some that half of the scenes are taken with, if there are any.
    """

    known: "tuple[KnownCamera, ...]" = ()

    def view(self, random: np.random.Generator, side: int, sensor: Size) -> CameraView:
        """How one of them takes a scene of `side` pixels with a sensor of (height, width)."""
        if self.known and random.random() < _OF_KNOWN:
            return self.known[int(random.integers(len(self.known)))].view(random, side, sensor)
        psf = random_psf(random, (sensor[0] + side, sensor[1] + side))
        gains = torch.tensor([random.uniform(0.3, 0.8), 1.0, random.uniform(0.3, 0.9)])
        electrons = _drawn(random, _ELECTRONS)
        return CameraView(
            psf,
            _light_of_one_psf(random, psf, side),
            gains[:, None, None],
            electrons,
            _READ_ELECTRONS,
            pixels_of(3),
        )


@dataclass(frozen=True)
class KnownCamera:
    """One camera, by its PSFs and its sensor.

    A scene to train on lies around its axis. The model has the PSF of the field point there, and
    the light comes by those of all, as far as the scene reaches. Of PSFs that are larger than the
    scene needs, some part around their middle is taken, on their own pixels or on binned ones.

    Parameters
    ----------
    psfs
        At one or more field points, of one channel or three.
    full_electrons, read_electrons
        At which a pixel is saturated, and its read noise; None where the sensor is not known.
    """

    psfs: FieldPsf
    full_electrons: float | None = None
    read_electrons: float = _READ_ELECTRONS

    @classmethod
    def of(cls, psfs: FieldPsf, sensor: Sensor | None) -> "KnownCamera":
        """With the noise of a sensor, where there is one."""
        if sensor is None:
            return cls(psfs)
        return cls(psfs, sensor.clip_electrons, sensor.read_noise_electrons)

    def view(self, random: np.random.Generator, side: int, sensor: Size) -> CameraView:
        """How it takes a scene of `side` pixels with a sensor of (height, width)."""
        size = sensor[0] + side, sensor[1] + side
        by = self._binning(random, size)
        planes = self.psfs.values.float()
        if by > 1:
            planes = nnf.avg_pool2d(planes, by)
        middle = self.psfs.middle
        gains = planes[middle].mean(dim=(-2, -1), keepdim=True)
        planes = _part(
            random, around_middle(planes, [max(a, b) for a, b in _sides(planes, size)]), size
        )
        planes = planes / planes.sum(dim=(-2, -1), keepdim=True).clamp_min(1e-30)
        psf, light = planes[middle], FieldPsf(planes, self.psfs.places / by)
        if light.points == 1 or random.random() >= _OVER_THE_FIELD:
            light = _light_of_one_psf(random, psf, side)
        elif random.random() < _ALTERED:
            psf = altered_psf(random, psf)
        tint = np.exp(random.normal(0, _TINT, gains.shape)).astype(np.float32)
        gains = gains / gains.max() * torch.from_numpy(tint)
        if self.full_electrons is None:
            electrons = _drawn(random, _ELECTRONS)
        else:
            electrons = self.full_electrons * _drawn(random, _FILLS)
        pixels = by**2 * pixels_of(len(gains))
        return CameraView(psf, light, gains, electrons, self.read_electrons, pixels)

    def _binning(self, random: np.random.Generator, size: Size) -> int:
        """Pixels that become one: more where the PSF is then still as large as is needed."""
        most = min(have // need for have, need in _sides(self.psfs.values, size))
        return int(random.integers(1, max(most, 1) + 1))


def _light_of_one_psf(random: np.random.Generator, psf: Tensor, side: int) -> FieldPsf:
    """A model's PSF or, mostly, another one on each side of a scene, both a little off."""
    if random.random() >= _OFF:
        return FieldPsf(psf[None], torch.zeros(1, 2))
    place = torch.zeros(2)
    place[int(random.integers(2))] = side / 2
    ends = torch.stack([altered_psf(random, psf) for _ in range(2)])
    return FieldPsf(ends, torch.stack([-place, place]))


def pixels_of(channels: int) -> Tensor:
    """Pixels of the sensor in one of the measurement: behind a mosaic green has two."""
    return torch.tensor([1.0, _GREENS, 1.0] if channels == 3 else [1.0])[:, None, None]


def _drawn(random: np.random.Generator, limits: tuple[float, float]) -> float:
    low, high = np.log(limits)
    return float(np.exp(random.uniform(low, high)))


def _sides(planes: Tensor, size: Size) -> list[tuple[int, int]]:
    return list(zip(planes.shape[-2:], size, strict=True))


def _part(random: np.random.Generator, planes: Tensor, size: Size) -> Tensor:
    """Some part of PSFs, the same of all; the one in the middle where others have little light."""
    room = [have - need for have, need in _sides(planes, size)]
    middle = [have // 2 - need // 2 for have, need in _sides(planes, size)]

    def cut(at: list[int]) -> Tensor:
        return planes[..., at[0] : at[0] + size[0], at[1] : at[1] + size[1]]

    enough = _LEAST_LIGHT * float(cut(middle).sum())
    for _ in range(_TRIED):
        part = cut([int(random.integers(0, each + 1)) for each in room])
        if float(part.sum()) >= enough and bool((part.sum(dim=(-2, -1)) > 0).all()):
            return part
    return cut(middle)
