"""Training of a network through all turns of a reconstruction, on random measurements."""

from collections import deque
from collections.abc import Iterator, Sequence

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import FOLDED, DenoisingNetwork
from nolens.solvers.plug_and_play import STRENGTH, Fit, PlugAndPlay
from nolens.training.cameras import TrainingCamera
from nolens.training.denoising import Trainer
from nolens.training.measurements import Example, random_size, simulate
from nolens.training.patches import PicturePool

_EXAMPLES = 700
"""Measurements to draw from, of which the oldest go."""
_REAL = 1 / 3
"""Fraction that is of real measurements, where there are any."""
_MEASURED, _LEAST = 60, 4
"""Measurements before the first step; a tenth of the steps where there are few."""
_NEW = 0.15
"""Measurements that are made for each that is solved."""
_APART = 0.35
"""Deviation of the logarithm of a strength: what is too strong for one scene suits another."""
_COARSE = 0.5
"""Fraction of the photographs to start from that have half the pixels along a side."""
_EARLIER = 0.1
"""Weight of the pictures of earlier turns beside the last one's."""


def tuned_from_white(network: DenoisingNetwork) -> DenoisingNetwork:
    """The same network told its white noise as the spread of the picture before.

    What `PlugAndPlay` says of the fit's noise has no effect until training gives it one.

    Parameters
    ----------
    network
        That takes out white noise.
    """
    told = DenoisingNetwork(network.widths, network.blocks)
    told.load_state_dict(network.state_dict())
    with torch.no_grad():
        weights = told.head.weight
        weights[:, -1] = weights[:, FOLDED:-1].sum(dim=1)
        weights[:, FOLDED:-1] = 0
    return told


class TurnLessons:
    r"""Losses of random measurements, solved by all turns with the network in training.

    Gradients go through the turns, and through the fits by their own linear step (`monakhova2020`):
    the network learns what makes the last picture good. Its loss is

    .. math:: \frac{‖z_K − v‖}{‖z_0 − v‖} + \frac{‖z_K − v‖_1}{‖z_0 − v‖_1}
       + 0.1 \sum_{k<K} \frac{k}{K} \frac{‖z_k − v‖}{‖z_0 − v‖}

    with the scene v and the photograph z₀ by total variation, so that good and poor measurements
    count alike.

    Parameters
    ----------
    pool
        Scenes are cut from its pictures.
    spreads
        Of the turns.
    camera
        That measures; None takes another one for each scene.
    pairs
        Real measurements, which stay; a third of those that are solved, if there are any.

    Attributes
    ----------
    examples
        Simulated measurements, the oldest first.
    """

    def __init__(
        self,
        pool: PicturePool,
        spreads: tuple[float, ...],
        camera: TrainingCamera | None = None,
        pairs: Sequence[Example] = (),
    ) -> None:
        self._pool, self._spreads, self._camera = pool, spreads, camera
        self._real = tuple(pairs)
        self.examples: deque[Example] = deque(maxlen=_EXAMPLES)

    def begin(self, trainer: Trainer, progress: ProgressCallback) -> None:
        """Make the first measurements, which depend on the trainer's seed and step."""
        seeds = np.random.SeedSequence(trainer.seed, spawn_key=(3, trainer.step))
        random = np.random.Generator(np.random.Philox(seeds))
        count = max(_LEAST, min(_MEASURED, trainer.schedule.steps // 10))
        for number in range(count):
            self._measure(random)
            progress((number + 1) / count)

    def losses(self, trainer: Trainer) -> Iterator[Tensor]:
        """Of the measurements of a step, one after the other."""
        random = trainer.random()
        for _ in range(trainer.schedule.patches):
            if random.random() < _NEW:
                self._measure(random)
            real = self._real and random.random() < _REAL
            among = self._real if real else self.examples
            example = among[int(random.integers(len(among)))]
            loss = self.loss(random, trainer.network, example)
            if bool(torch.isfinite(loss)):
                yield loss

    def loss(
        self, random: np.random.Generator, network: DenoisingNetwork, example: Example
    ) -> Tensor:
        """Of one measurement.

        Parameters
        ----------
        random
            Strength, and what the turns start from, come from it.
        network
            In training.
        example
            What was measured.
        """
        example = example.to(network.head.weight.device)
        problem, photograph = example.problem, example.photograph
        fit = Fit(problem, photograph)
        start = _halved(photograph) if random.random() < _COARSE else photograph
        strength = float(np.exp(random.normal(np.log(STRENGTH), _APART)))
        turns = PlugAndPlay(network, self._spreads).turns(problem, start, strength, fit)
        loss, count = torch.zeros(()), len(self._spreads)
        for number, turn in enumerate(turns, start=1):
            truth = example.truth.to(turn.picture) / turn.white
            error = turn.picture - truth
            first = photograph.to(truth) / turn.white - truth
            part = _ratio(error.square().mean(), first.square().mean()).sqrt()
            if number < count:
                loss = loss + _EARLIER * number / count * part.to(loss)
            else:
                loss = loss + (part + _ratio(error.abs().mean(), first.abs().mean())).to(loss)
        return loss

    def _measure(self, random: np.random.Generator) -> None:
        side, sensor = random_size(random)
        scene = self._pool.patches(random, 1, side)[0]
        self.examples.append(simulate(random, scene, sensor, self._camera))


def _ratio(one: Tensor, other: Tensor) -> Tensor:
    return one / other.clamp_min(1e-9)


def _halved(picture: Tensor) -> Tensor:
    """On half the pixels along a side, and back."""
    height, width = picture.shape[1:]
    half = nnf.interpolate(
        picture[None], size=(max(height // 2, 1), max(width // 2, 1)), mode="area"
    )
    return nnf.interpolate(half, size=(height, width), mode="bilinear", align_corners=False)[0]
