"""Simulated measurements to train on, of cameras that differ from their model."""

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from torch import Tensor

from nolens.operators import FieldConvolution, PixelRectangle
from nolens.solvers import Reconstructor
from nolens.solvers.held_out import weight_by_noise
from nolens.solvers.plug_and_play import PlugAndPlay, Turn
from nolens.training.cameras import RandomCameras, TrainingCamera

_SCENE, _SENSOR = (112, 256), (192, 480)
"""Smallest and largest side of a scene and of a sensor."""
_WIDER = 1.0, 2.3
"""A sensor's side over its scene's, where that makes it neither smaller nor larger than above."""
_STRONGER, _WEIGHTS = 0.2, 0.5
"""Mean and deviation of the logarithm of total variation's weight over what the noise asks for."""
_HAZE, _ROWS = 0.3, 0.2
"""Fractions of the measurements with light beside the PSF's, and with offsets of rows."""


@dataclass(frozen=True)
class Shot:
    """A measurement, the PSF that its camera is taken to have, and the scene that was there.

    Parameters
    ----------
    psf
        (channels, height, width).
    values
        Linear, (channels, height, width).
    support
        Where the scene lies.
    truth
        On the support's pixels, in units of measurement over PSF.
    valid
        Pixels that take part in a fit; None for all.
    """

    psf: Tensor = field(repr=False)
    values: Tensor = field(repr=False)
    support: PixelRectangle
    truth: Tensor = field(repr=False)
    valid: Tensor | None = field(default=None, repr=False)


@dataclass(frozen=True)
class Example:
    """The last turn of a reconstruction, and the scene that was there; without colours, three times
    the same.

    Parameters
    ----------
    turn
        Of the network, of three channels.
    truth
        In units of the turn's white, made as bright as the turn's picture.
    """

    turn: Turn = field(repr=False)
    truth: Tensor = field(repr=False)


def random_size(random: np.random.Generator) -> tuple[int, tuple[int, int]]:
    """Side of a scene, and (height, width) of a sensor."""
    side = int(random.integers(_SCENE[0], _SCENE[1] + 1))
    height, width = (
        min(max(int(side * random.uniform(*_WIDER)), _SENSOR[0]), _SENSOR[1]) for _ in range(2)
    )
    return side, (height, width)


def reconstruct_shot(
    shot: Shot, prior: PlugAndPlay, random: np.random.Generator, device: torch.device | None = None
) -> Example:
    """What the last turn makes of a measurement, by the way that a photograph goes.

    Parameters
    ----------
    shot
        The measurement.
    prior
        Whose turns they are.
    random
        The weight of the photograph that turns start from comes from it.
    device
        Where to compute; None for the CPU. The example is on the CPU.
    """
    turns: list[Turn] = []

    def keep(turn: Turn) -> Tensor:
        turns.append(turn)
        return turn.picture

    solver = Reconstructor(
        shot.psf,
        shot.support,
        tau=0.0,
        prior=replace(prior, refinement=keep),
        device="cpu" if device is None else device,
    )
    problem = solver.problem(shot.values, shot.valid)
    factor = float(np.exp(random.normal(_STRONGER, _WEIGHTS)))
    solver.solve(problem.weighted(factor * weight_by_noise(problem.by_channel).tau))
    (last,) = turns
    truth = shot.truth / last.white
    picture = last.picture.to(truth)
    truth = truth * picture.square().sum() / (picture * truth).sum().clamp_min(1e-12)

    def three(each: Tensor) -> Tensor:
        """On the CPU."""
        return each.cpu().expand(3, *each.shape[1:])

    last = replace(
        last,
        fit=three(last.fit),
        picture=three(last.picture),
        multiplier=three(last.multiplier),
        noise=three(last.noise),
    )
    return Example(last, three(truth))


def simulate(
    random: np.random.Generator,
    truth: Tensor,
    sensor: tuple[int, int],
    camera: TrainingCamera | None = None,
) -> Shot:
    """The measurement of a scene by a camera.

    Its colours are weighed as behind a mosaic; noise is that of electrons and of reading them. The
    light comes by the PSFs of the camera's view, over the whole scene, sometimes with haze and
    offsets of rows.

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
    support = PixelRectangle.centred(side, side, sensor)
    view = (camera or RandomCameras()).view(random, side, sensor)
    if len(view.psf) == 1:
        truth = truth.mean(dim=0, keepdim=True)
    middle = torch.tensor([each // 2 for each in sensor])
    field = FieldConvolution(view.light.values, view.light.places + middle, sensor, support)
    light = view.gains * field(truth).clamp_min(0)
    if random.random() < _HAZE:
        light = light + abs(random.normal(0, 0.02)) * light.mean()
    brightness = view.electrons / max(float(light.max()), 1e-30)
    electrons = brightness * light
    spread = ((electrons + view.read_electrons**2) / view.pixels).sqrt()
    noisy = electrons + spread * torch.from_numpy(random.standard_normal(light.shape, np.float32))
    if random.random() < _ROWS:
        offsets = random.normal(0, 1, (1, sensor[0], 1)).astype(np.float32)
        noisy = noisy + 0.3 * float(spread.mean()) * torch.from_numpy(offsets)
    return Shot(view.gains * view.psf, noisy, support, brightness * truth)
