"""Simulated measurements to train on, of cameras that differ from their model."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Prior, Problem, admm
from nolens.solvers.held_out import weight_by_noise
from nolens.training.cameras import RandomCameras, TrainingCamera
from nolens.training.psfs import altered_psf

_SCENE, _SENSOR = (96, 160), (112, 224)
"""Smallest and largest side of a scene and of a sensor."""
_ITERATIONS = 16
"""Of a photograph by total variation."""
_WEIGHTS = 0.4
"""Deviation of the logarithm of its weight from that which the noise asks for."""
_OFF = 0.5
"""Fraction of the measurements whose PSF is not that of the model."""


@dataclass(frozen=True)
class Example:
    """A problem, and the scene that was there.

    Parameters
    ----------
    problem
        As a reconstruction would have it.
    truth
        On the problem's scene pixels, in units of measurement over PSF.
    photograph
        By total variation, in the same units.
    """

    problem: Problem
    truth: Tensor
    photograph: Tensor

    def to(self, device: torch.device) -> Self:
        """The same on a device."""
        return replace(
            self,
            problem=self.problem.to(device),
            truth=self.truth.to(device),
            photograph=self.photograph.to(device),
        )


def random_size(random: np.random.Generator) -> tuple[int, tuple[int, int]]:
    """Side of a scene, and (height, width) of a sensor."""
    height, width = (int(random.integers(_SENSOR[0], _SENSOR[1] + 1)) for _ in range(2))
    return int(random.integers(_SCENE[0], _SCENE[1] + 1)), (height, width)


def simulate(
    random: np.random.Generator,
    truth: Tensor,
    sensor: tuple[int, int],
    camera: TrainingCamera | None = None,
) -> Example:
    """The measurement of a scene by a camera.

    Its colours are weighed as behind a mosaic; noise is that of electrons and of reading them. In
    part of the measurements the light comes by other PSFs than the problem's: turned, scaled,
    blurred, changing over the field, with haze and offsets of rows.

    Parameters
    ----------
    random
        All that is random comes from it.
    truth
        (3, side, side), from 0 to 1: all that there is, around the middle.
    sensor
        (height, width) of the measurement.
    camera
        What it is taken with; None takes any camera.
    """
    side = truth.shape[-1]
    support = PixelRectangle(
        (sensor[0] - side) // 2, (sensor[1] - side) // 2, truth.shape[-2], truth.shape[-1]
    )
    view = (camera or RandomCameras()).view(random, (sensor[0] + side, sensor[1] + side))
    if len(view.psf) == 1:
        truth = truth.mean(dim=0, keepdim=True)
    off = random.random() < _OFF
    if off:
        light = view.gains * _light(random, view.ends, truth, sensor, support)
    else:
        light = view.gains * _image(view.psf, truth, sensor, support)
    if off and random.random() < 0.5:
        light = light + abs(random.normal(0, 0.02)) * light.mean()
    brightness = view.electrons / max(float(light.max()), 1e-30)
    electrons = brightness * light
    spread = ((electrons + view.read_electrons**2) / view.pixels).sqrt()
    noisy = electrons + spread * torch.from_numpy(random.standard_normal(light.shape, np.float32))
    if off and random.random() < 0.3:
        offsets = random.normal(0, 1, (1, sensor[0], 1)).astype(np.float32)
        noisy = noisy + 0.3 * float(spread.mean()) * torch.from_numpy(offsets)
    prior = Prior.COLOUR_TV if len(view.psf) == 3 else Prior.TV
    problem = Problem.build(view.gains * view.psf, noisy, support=support, prior=prior)
    weight = weight_by_noise(problem.by_channel).tau * float(np.exp(random.normal(0, _WEIGHTS)))
    first = admm(problem.weighted(weight), iterations=_ITERATIONS, low_frequency=True)
    return Example(problem, brightness * truth, first.scene)


def _image(psf: Tensor, truth: Tensor, sensor: tuple[int, int], support: PixelRectangle) -> Tensor:
    return CroppedConvolution(psf, sensor, support)(truth).clamp_min(0)


def _light(
    random: np.random.Generator,
    psfs: tuple[Tensor, Tensor],
    truth: Tensor,
    sensor: tuple[int, int],
    support: PixelRectangle,
) -> Tensor:
    """By one PSF on one side of the scene, and by another one on the other, each altered."""
    slope = torch.linspace(0, 1, truth.shape[-1])
    if random.random() < 0.5:
        slope = slope[:, None]
    one, other = (altered_psf(random, each) for each in psfs)
    return _image(one, slope * truth, sensor, support) + _image(
        other, (1 - slope) * truth, sensor, support
    )
