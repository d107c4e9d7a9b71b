"""Simulated measurements to train on, of random cameras that differ from their model."""

from dataclasses import dataclass
from functools import partial

import numpy as np
import torch
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers import Prior, Problem, admm
from nolens.solvers.held_out import weight_by_noise
from nolens.training.psfs import altered_psf, random_psf

_SCENE, _SENSOR = (96, 160), (112, 224)
"""Smallest and largest side of a scene and of a sensor."""
_ELECTRONS = 200.0, 20_000.0
"""In the brightest pixel."""
_READ_ELECTRONS = 3.0
_ITERATIONS = 16
"""Of a photograph by total variation."""
_WEIGHTS = 0.4
"""Deviation of the logarithm of its weight from that which the noise asks for."""
_OFF = 0.6
"""Fraction of the cameras whose PSF is not that of the model."""


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


def random_size(random: np.random.Generator) -> tuple[int, tuple[int, int]]:
    """Side of a scene, and (height, width) of a sensor."""
    height, width = (int(random.integers(_SENSOR[0], _SENSOR[1] + 1)) for _ in range(2))
    return int(random.integers(_SCENE[0], _SCENE[1] + 1)), (height, width)


def simulate(random: np.random.Generator, truth: Tensor, sensor: tuple[int, int]) -> Example:
    """The measurement of a scene by a random camera.

    Its colours are weighed as behind a mosaic; noise is that of electrons and of reading them. In
    part of the cameras the light comes by another PSF than the problem's: turned, scaled, blurred,
    changing over the field, with haze and offsets of rows.

    Parameters
    ----------
    random
        All that is random comes from it.
    truth
        (3, side, side), from 0 to 1: all that there is, around the middle.
    sensor
        (height, width) of the measurement.
    """
    side = truth.shape[-1]
    support = PixelRectangle(
        (sensor[0] - side) // 2, (sensor[1] - side) // 2, truth.shape[-2], truth.shape[-1]
    )
    psf = random_psf(random, (sensor[0] + side, sensor[1] + side))
    gains = torch.tensor([random.uniform(0.3, 0.8), 1.0, random.uniform(0.3, 0.9)])
    gains = gains[:, None, None]
    off = random.random() < _OFF
    image = partial(_light, random) if off else _image
    light = gains * image(psf, truth, sensor, support)
    if off and random.random() < 0.5:
        light = light + abs(random.normal(0, 0.02)) * light.mean()
    low, high = np.log(_ELECTRONS)
    electrons = light * (float(np.exp(random.uniform(low, high))) / float(light.max()))
    # A superpixel has twice as much green.
    counts = torch.tensor([1.0, 2.0, 1.0])[:, None, None]
    spread = ((electrons + _READ_ELECTRONS**2) / counts).sqrt()
    noisy = electrons + spread * torch.from_numpy(random.standard_normal(light.shape, np.float32))
    if off and random.random() < 0.3:
        offsets = random.normal(0, 1, (1, sensor[0], 1)).astype(np.float32)
        noisy = noisy + 0.3 * float(spread.mean()) * torch.from_numpy(offsets)
    problem = Problem.build(gains * psf, noisy, support=support, prior=Prior.COLOUR_TV)
    weight = weight_by_noise(problem.by_channel).tau * float(np.exp(random.normal(0, _WEIGHTS)))
    first = admm(problem.weighted(weight), iterations=_ITERATIONS, low_frequency=True)
    brightness = float(electrons.max()) / float(light.max())
    return Example(problem, brightness * truth, first.scene)


def _image(psf: Tensor, truth: Tensor, sensor: tuple[int, int], support: PixelRectangle) -> Tensor:
    return CroppedConvolution(psf, sensor, support)(truth).clamp_min(0)


def _light(
    random: np.random.Generator,
    psf: Tensor,
    truth: Tensor,
    sensor: tuple[int, int],
    support: PixelRectangle,
) -> Tensor:
    """By one PSF on one side of the scene, and by another one on the other."""
    slope = torch.linspace(0, 1, truth.shape[-1])
    if random.random() < 0.5:
        slope = slope[:, None]
    one, other = altered_psf(random, psf), altered_psf(random, psf)
    return _image(one, slope * truth, sensor, support) + _image(
        other, (1 - slope) * truth, sensor, support
    )
