"""Training of a network that mends what all turns of a reconstruction leave."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels.threads import one_thread
from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import FOLDED, PLANES, DenoisingNetwork, noise_planes
from nolens.solvers.plug_and_play import REFINED_PICTURES, PlugAndPlay, Refinement
from nolens.training.cameras import TrainingCamera
from nolens.training.denoising import Trainer
from nolens.training.measurements import Example, Shot, random_size, reconstruct_shot, simulate
from nolens.training.patches import PicturePool

_MOST, _LEAST = 1000, 4
"""Measurements to learn from."""
_STEPS_OF_EACH = 4
"""Steps for each of them."""
_EXAMPLE_BYTES = 1.8e6
"""Three pictures and the truth, float32, of three channels and 190×190 pixels in the mean."""
_REAL = 1 / 3
"""Fraction of the patches that are of real measurements, where there are any."""
_SHARE, _FINEST = 0.7, 0.05
"""Limits of a `Refinement` that learnt on random cameras (decision 24)."""
_NEAR = 1e-3
"""Error, of the white, below which smaller ones count no more."""
_OTHERS = 0.02
"""Deviation of the first weights of pictures that the network did not see before."""
_SWAPPED = 0.3
"""Fraction of the patches whose channels are in another order."""


def refinement_network(network: DenoisingNetwork) -> DenoisingNetwork:
    """A network of a `Refinement` with features of one that takes out noise; it changes nothing.

    Parameters
    ----------
    network
        That takes out white noise.
    """
    own = DenoisingNetwork(network.widths, network.blocks, REFINED_PICTURES)
    own.load_state_dict({**own.state_dict(), **_without_head(network)})
    with torch.no_grad():
        before, head = network.head.weight, own.head.weight
        head.normal_(0, _OTHERS, generator=torch.Generator().manual_seed(0))
        # The second picture is what the network before saw; its noise was the spread.
        head[:, FOLDED : 2 * FOLDED] = before[:, :FOLDED]
        head[:, -PLANES:] = 0
        head[:, -1] = before[:, FOLDED:].sum(dim=1)
        own.tail.weight.zero_()
    return own


def _without_head(network: DenoisingNetwork) -> dict[str, Tensor]:
    return {
        name: each for name, each in network.state_dict().items() if not name.startswith("head.")
    }


def refinement_for_others(network: DenoisingNetwork) -> Refinement:
    """Of a network that learnt on random cameras, for pictures by others."""
    return Refinement(network, share=_SHARE, finest=_FINEST)


def lessons_bytes(steps: int) -> float:
    """Memory that the reconstructions of a training of so many steps take."""
    return lessons_count(steps) * _EXAMPLE_BYTES


def lessons_count(steps: int) -> int:
    """Measurements that a training of so many steps learns from."""
    return max(_LEAST, min(_MOST, steps // _STEPS_OF_EACH))


class RefinementLessons:
    r"""Patches of reconstructions by turns, which do not change, and the loss of each.

    With the last turn's picture z, what the network makes of it, F, and the scene v, the loss is
    the mean of

    .. math:: \log \frac{\overline{(F − v)^2} + ε^2}{\overline{(z − v)^2} + ε^2}

    so that good and poor reconstructions count alike.

    Parameters
    ----------
    pool
        Scenes are cut from its pictures.
    prior
        Whose turns they are.
    camera
        That measures; None takes another one for each scene.
    pairs
        Real measurements; a third of the patches is of them, if there are any.

    Attributes
    ----------
    examples
        Simulated ones.
    """

    def __init__(
        self,
        pool: PicturePool,
        prior: PlugAndPlay,
        camera: TrainingCamera | None = None,
        pairs: Sequence[Shot] = (),
    ) -> None:
        self._pool, self._prior, self._camera = pool, prior, camera
        self._pairs = tuple(pairs)
        self._real: list[Example] = []
        self.examples: list[Example] = []

    def begin(self, trainer: Trainer, progress: ProgressCallback) -> None:
        """Measure and reconstruct; the same from the same seed."""
        count, device = lessons_count(trainer.schedule.steps), trainer.device

        def simulated(number: int) -> Example:
            random = _random(trainer.seed, 3, number)
            side, sensor = random_size(random)
            shot = simulate(random, self._pool.patches(random, 1, side)[0], sensor, self._camera)
            return reconstruct_shot(shot, self._prior, random, device)

        def real(number: int) -> Example:
            random = _random(trainer.seed, 4, number)
            return reconstruct_shot(self._pairs[number], self._prior, random, device)

        with one_thread() as workers, ThreadPoolExecutor(workers) as threads:
            for number, example in enumerate(threads.map(simulated, range(count)), start=1):
                self.examples.append(example)
                progress(number / count)
            self._real = list(threads.map(real, range(len(self._pairs))))

    def losses(self, trainer: Trainer) -> Iterator[Tensor]:
        """Of the next patches, which depend on nothing but the trainer's seed and step."""
        random, schedule = trainer.random(), trainer.schedule
        patches = [self._patch(random, schedule.side) for _ in range(schedule.patches)]
        pictures, truth, planes = (
            torch.cat(each).to(trainer.device) for each in zip(*patches, strict=True)
        )
        made = trainer.network(pictures.contiguous(memory_format=torch.channels_last), planes)
        before, after = (
            (each - truth).square().mean(dim=(1, 2, 3)) + _NEAR**2
            for each in (pictures[:, :3], made)
        )
        yield (after / before).log().mean()

    def _patch(self, random: np.random.Generator, side: int) -> tuple[Tensor, Tensor, Tensor]:
        """Pictures, truth and planes of the noise, each with a first dimension of 1."""
        among = self._real if self._real and random.random() < _REAL else self.examples
        example = among[int(random.integers(len(among)))]
        noise = example.turn.noise
        every = torch.cat([example.turn.pictures.flatten(0, 1), example.truth])
        missing = [max(side - each, 0) for each in every.shape[1:]]
        every = nnf.pad(every[None], (0, missing[1], 0, missing[0]), mode="reflect")[0]
        top, left = (int(random.integers(0, each - side + 1)) for each in every.shape[1:])
        every = every[:, top : top + side, left : left + side]
        every = torch.rot90(every, int(random.integers(4)), (1, 2))
        if random.random() < 0.5:
            every = every.flip(2)
        if random.random() < _SWAPPED:
            order = torch.from_numpy(random.permutation(3))
            every, noise = every.reshape(-1, 3, side, side)[:, order].flatten(0, 1), noise[order]
        planes = noise_planes(noise[None], example.turn.spread)
        return every[None, :-3], every[None, -3:], planes


def _random(*key: int) -> np.random.Generator:
    return np.random.Generator(np.random.Philox(np.random.SeedSequence(key[0], spawn_key=key[1:])))
