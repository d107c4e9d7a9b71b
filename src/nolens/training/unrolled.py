"""Training of a network on what the fit of random measurements gives it, turn by turn."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import DenoisingNetwork, noise_planes
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.training.cameras import TrainingCamera
from nolens.training.denoising import Batch, Schedule, Trainer
from nolens.training.measurements import Example, random_size, simulate
from nolens.training.patches import PicturePool

_PAIRS = 1200
"""To draw patches from: fits of about the last hundred measurements."""
_EXAMPLES = 1500
"""Measurements to draw from, of which the oldest go."""
_REAL = 1 / 3
"""Fraction of the fits that are of real measurements, where there are any."""
_MEASURED, _LEAST, _ROUNDS = 140, 4, 2
"""Measurements before the first step, a tenth of the steps where there are few; fits of each."""
_STEPS_BETWEEN = 4
"""From one new measurement to the next."""
_JITTER = 0.3
"""Deviation of the logarithm of an example's spreads."""


@dataclass(frozen=True)
class _Pair:
    fit: Tensor
    truth: Tensor
    planes: Tensor
    error: float


class FitBuffer:
    """Fits of random measurements, each turn with the network of its time.

    The network is the one in training, so that it learns from the errors that it leaves itself,
    turn after turn (`ross2011`). No gradient goes through the fit: in each turn the network's aim
    is the scene.

    Parameters
    ----------
    pool
        Scenes are cut from its pictures.
    spreads
        Of the turns.
    camera
        That measures; None takes another one for each scene.
    pairs
        Real measurements, which stay; a third of the fits of any are of them.
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
        self._examples: deque[Example] = deque(maxlen=_EXAMPLES)
        self._pairs: deque[_Pair] = deque(maxlen=_PAIRS)

    def __len__(self) -> int:
        return len(self._examples)

    def measure(self, random: np.random.Generator) -> None:
        """Add a measurement.

        Parameters
        ----------
        random
            All that is random comes from it.
        """
        side, sensor = random_size(random)
        scene = self._pool.patches(random, 1, side)[0]
        self._examples.append(simulate(random, scene, sensor, self._camera))

    def solve(
        self, random: np.random.Generator, network: DenoisingNetwork, number: int | None = None
    ) -> None:
        """Solve one of the measurements, and keep its turns.

        Parameters
        ----------
        random
            All that is random comes from it.
        network
            As it is now.
        number
            Of the measurement, −1 for the last; None for any, which may be a real one.
        """
        real = number is None and self._real and random.random() < _REAL
        among = self._real if real else self._examples
        example = among[int(random.integers(len(among))) if number is None else number]
        factor = float(np.exp(random.normal(0, _JITTER)))
        solver = PlugAndPlay(network, tuple(factor * each for each in self._spreads))
        turns = solver.turns(example.problem, example.photograph)
        for spread, turn in zip(solver.spreads, turns, strict=True):
            truth = example.truth / turn.white
            error = float((turn.noisy - truth).square().mean().sqrt())
            if np.isfinite(error):
                # A measurement without colours is three that are the same, as in `denoise`.
                fit, same = (each.expand(3, -1, -1) for each in (turn.noisy, truth))
                planes = noise_planes(turn.noise.expand(3, -1)[None], spread)[0]
                self._pairs.append(_Pair(fit, same, planes, error))

    def batch(self, random: np.random.Generator, schedule: Schedule) -> Batch:
        """Patches of random turns, turned and mirrored.

        Parameters
        ----------
        random
            All that is random comes from it.
        schedule
            Number and size of the patches.
        """
        noisy, clean, planes, errors = [], [], [], []
        for number in random.integers(len(self._pairs), size=schedule.patches):
            kept = self._pairs[int(number)]
            pair = torch.stack([kept.fit, kept.truth])
            top, left = (
                int(random.integers(0, have - schedule.side + 1)) for have in pair.shape[2:]
            )
            pair = pair[..., top : top + schedule.side, left : left + schedule.side]
            pair = torch.rot90(pair, int(random.integers(4)), (2, 3))
            pair = pair.flip(3) if random.random() < 0.5 else pair
            noisy.append(pair[0])
            clean.append(pair[1])
            planes.append(kept.planes)
            errors.append(kept.error)
        return Batch(
            torch.stack(noisy), torch.stack(clean), torch.stack(planes), torch.tensor(errors)
        )


class FitLessons:
    """Batches of what the fit of measurements leaves.

    Parameters
    ----------
    buffer
        Of the fits.
    """

    def __init__(self, buffer: FitBuffer) -> None:
        self._buffer = buffer

    def begin(self, trainer: Trainer, progress: ProgressCallback) -> None:
        """Fill the buffer: with measurements that depend on the trainer's seed and step."""
        seeds = np.random.SeedSequence(trainer.seed, spawn_key=(3, trainer.step))
        random = np.random.Generator(np.random.Philox(seeds))
        measured = max(_LEAST, min(_MEASURED, trainer.schedule.steps // 10))
        for number in range(measured):
            self._buffer.measure(random)
            progress(0.6 * (number + 1) / measured)
        fits = _ROUNDS * measured
        for number in range(fits):
            self._buffer.solve(random, trainer.network, number % measured)
            progress(0.6 + 0.4 * (number + 1) / fits)

    def batch(self, trainer: Trainer) -> Batch:
        """The next batch; now and then after fits of another measurement, and one measured."""
        random = trainer.random()
        if trainer.step % _STEPS_BETWEEN == 0:
            self._buffer.solve(random, trainer.network)
        if trainer.step % (2 * _STEPS_BETWEEN) == 0:
            self._buffer.measure(random)
        return self._buffer.batch(random, trainer.schedule)
