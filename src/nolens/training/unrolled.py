"""Training of a network on what the fit of random measurements gives it, turn by turn."""

from collections import deque
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from nolens.solvers.denoising_network import DenoisingNetwork, noise_planes
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.training.denoising import Batch, Schedule
from nolens.training.measurements import Example, random_size, simulate
from nolens.training.patches import PicturePool

_PAIRS = 1200
"""To draw patches from: fits of about the last hundred measurements."""
_EXAMPLES = 1500
"""Measurements to draw from, of which the oldest go."""
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
    """

    def __init__(self, pool: PicturePool, spreads: tuple[float, ...]) -> None:
        self._pool, self._spreads = pool, spreads
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
        self._examples.append(simulate(random, scene, sensor))

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
            Of the measurement, −1 for the last; None for any.
        """
        chosen = int(random.integers(len(self._examples))) if number is None else number
        example = self._examples[chosen]
        factor = float(np.exp(random.normal(0, _JITTER)))
        solver = PlugAndPlay(network, tuple(factor * each for each in self._spreads))
        turns = solver.turns(example.problem, example.photograph)
        for spread, turn in zip(solver.spreads, turns, strict=True):
            truth = example.truth / turn.white
            error = float((turn.fit - truth).square().mean().sqrt())
            if np.isfinite(error):
                planes = noise_planes(turn.noise[None], spread)[0]
                self._pairs.append(_Pair(turn.fit, truth, planes, error))

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
