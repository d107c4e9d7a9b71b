"""Training of a network to take white noise out of pictures."""

import math
import warnings
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.optim.swa_utils import get_ema_multi_avg_fn

from nolens.progress import ProgressCallback
from nolens.solvers.denoising_network import DenoisingNetwork, Precision, noise_planes
from nolens.training.patches import PicturePool


@dataclass(frozen=True)
class Batch:
    """What a network learns from.

    Parameters
    ----------
    noisy, clean
        (count, 3, height, width).
    planes
        Of the noise (`noise_planes`).
    error
        Mean deviation of the noise, (count,).
    """

    noisy: Tensor
    clean: Tensor
    planes: Tensor
    error: Tensor


_SIGMAS = 0.003, 0.5
"""Smallest and largest standard deviation of the noise, of a white of 1."""
_APART = 0.4
"""Deviation of the logarithm of a channel's noise from that of the others."""
_DECAY = 0.999
"""Of the mean of the weights over the steps, which is what is kept."""
_CLIP = 1.0
_MOMENTS = "exp_avg", "exp_avg_sq"
"""Of Adam, as it calls them."""
_WORKERS, _AHEAD = 6, 24
"""Threads that make batches for a CUDA device, and how many batches they are ahead of it."""


@dataclass(frozen=True)
class Schedule:
    """How long and how fast a network learns.

    Parameters
    ----------
    steps
        Number of batches.
    rate
        Largest step of Adam; it rises over the first twentieth and falls as a cosine.
    patches, side
        Of a batch: how many, and their pixels along a side.
    precision
        Of the features and their gradients; weights and moments always have float32.
    """

    steps: int
    rate: float = 1.5e-3
    patches: int = 24
    side: int = 64
    precision: Precision = "float32"

    def rate_at(self, step: int) -> float:
        """Step of Adam at a batch."""
        rise = max(self.steps // 20, 1)
        fallen = 0.5 * (1 + math.cos(math.pi * min(step / self.steps, 1.0)))
        return self.rate * min((step + 1) / rise, 1.0) * max(fallen, 0.005)


class Trainer:
    """A network, its optimiser and the mean of its weights: all that a checkpoint holds.

    Parameters
    ----------
    network
        Where to start from.
    schedule
        How long and how fast.
    seed
        Of the batches.
    device
        Where the network learns; batches are made on the CPU.
    """

    def __init__(
        self,
        network: DenoisingNetwork,
        schedule: Schedule,
        seed: int,
        device: torch.device | None = None,
    ) -> None:
        self.device = torch.device("cpu") if device is None else device
        self.network = network.to(self.device)
        self.network.precision = schedule.precision
        self.schedule, self.seed, self.step = schedule, seed, 0
        self._optimiser = torch.optim.AdamW(
            network.parameters(),
            lr=schedule.rate,
            weight_decay=1e-4,
            fused=self.device.type == "cuda",
        )
        self._mean = {name: each.clone() for name, each in network.state_dict().items()}

    def random(self, step: int | None = None) -> np.random.Generator:
        """Random numbers of a batch, the next one's by default: the same after a resumed run."""
        number = self.step if step is None else step
        return np.random.Generator(
            np.random.Philox(np.random.SeedSequence(self.seed, spawn_key=(2, number)))
        )

    def learn(self, losses: Iterable[Tensor]) -> Tensor:
        """One step by the sum of losses; their mean, on the device, which may still be at work."""
        for group in self._optimiser.param_groups:
            group["lr"] = self.schedule.rate_at(self.step)
        self._optimiser.zero_grad(set_to_none=True)
        values = []
        for loss in losses:
            loss.backward()  # type: ignore[no-untyped-call]
            values.append(loss.detach().float())
        torch.nn.utils.clip_grad_norm_(self.network.parameters(), _CLIP)
        self._optimiser.step()
        self.step += 1
        decay = min(_DECAY, (1 + self.step) / (10 + self.step))
        weights = self.network.state_dict()
        average = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
        average([self._mean[name] for name in weights], list(weights.values()), self.step)
        return torch.stack(values).mean() if values else torch.zeros(())

    def trained(self) -> DenoisingNetwork:
        """The network with the mean of its weights, on the CPU."""
        return network_of(self._mean, like=self.network)

    def arrays(self) -> dict[str, Tensor]:
        """All that `restore` needs beside the number of steps, by name."""
        moments = self._optimiser.state_dict()["state"]
        return {
            **prefixed("network", self.network.state_dict()),
            **prefixed("mean", self._mean),
            **{
                f"optimiser.{number}.{name}": each
                for number, those in moments.items()
                for name, each in those.items()
            },
        }

    def like_arrays(self) -> dict[str, Tensor]:
        """Tensors of the shapes and types that `arrays` has after the first step."""
        like = {
            **prefixed("network", self.network.state_dict()),
            **prefixed("mean", self._mean),
        }
        for number, each in enumerate(self.network.parameters()):
            like[f"optimiser.{number}.step"] = torch.zeros(())
            like |= {f"optimiser.{number}.{name}": each.detach() for name in _MOMENTS}
        return like

    def restore(self, arrays: Mapping[str, Tensor], step: int) -> None:
        """Go on from `arrays` of a trainer that has done so many steps."""
        self.step = step
        self.network.load_state_dict(without_prefix("network", arrays))
        mean = without_prefix("mean", arrays)
        self._mean = {name: each.to(self.device) for name, each in mean.items()}
        moments: dict[int, dict[str, Any]] = {}
        for name, each in without_prefix("optimiser", arrays).items():
            number, _, what = name.partition(".")
            moments.setdefault(int(number), {})[what] = each
        groups = self._optimiser.state_dict()["param_groups"]
        self._optimiser.load_state_dict({"state": moments, "param_groups": groups})


def prefixed(prefix: str, arrays: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The same arrays under names that begin with a prefix and a dot."""
    return {f"{prefix}.{name}": each for name, each in arrays.items()}


def without_prefix(prefix: str, arrays: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Those arrays whose names begin with a prefix and a dot, under the rest of their names."""
    start = f"{prefix}."
    return {
        name.removeprefix(start): each for name, each in arrays.items() if name.startswith(start)
    }


def network_of(weights: Mapping[str, Tensor], like: DenoisingNetwork) -> DenoisingNetwork:
    """A network of the size of another one, with weights of its own."""
    network = DenoisingNetwork(like.widths, like.blocks, like.pictures)
    network.load_state_dict(weights)
    return network.eval()


def noisy_batch(pool: PicturePool, random: np.random.Generator, schedule: Schedule) -> Batch:
    """Patches with white noise, of another strength in each and somewhat in each channel.

    Parameters
    ----------
    pool
        What patches are cut from.
    random
        All that is random comes from it.
    schedule
        Number and size of the patches.
    """
    clean = pool.patches(random, schedule.patches, schedule.side)
    low, high = np.log(_SIGMAS)
    level = np.exp(random.uniform(low, high, (len(clean), 1, 1, 1)))
    apart = np.exp(random.normal(0, _APART, (len(clean), 3, 1, 1)))
    noise = random.standard_normal(tuple(clean.shape), np.float32)
    grey = (clean == clean[:, :1]).flatten(1).all(dim=1).numpy()
    apart[grey], noise[grey] = apart[grey, :1], noise[grey, :1]
    sigma = torch.from_numpy((level * apart).clip(*_SIGMAS).astype(np.float32))
    noisy = clean + sigma * torch.from_numpy(noise)
    return Batch(noisy, clean, noise_planes(sigma[..., 0, 0]), sigma.mean(dim=(1, 2, 3)))


@dataclass
class NoiseLessons:
    """Batches of white noise, and the loss of each.

    It is the mean of |D(v) − clean| / σ, so that strong and weak noise count alike. For a CUDA
    device, threads make the batches that come next, and the network's passes become a graph: it
    would wait for both most of the time.

    Parameters
    ----------
    pool
        What patches are cut from.
    """

    pool: PicturePool
    _threads: ThreadPoolExecutor | None = field(default=None, init=False, repr=False)
    _coming: dict[int, Future[Batch]] = field(default_factory=dict, init=False, repr=False)

    def begin(self, trainer: Trainer, progress: ProgressCallback) -> None:
        """Record the passes on a CUDA device; nothing has to be there otherwise."""
        if trainer.device.type == "cuda":
            # The graph's own stream is not that of other steps, which costs nothing here.
            warnings.filterwarnings("ignore", "The AccumulateGrad node's stream")
            self._threads = ThreadPoolExecutor(_WORKERS)
            batch = noisy_batch(self.pool, trainer.random(), trainer.schedule)
            noisy = batch.noisy.to(trainer.device, memory_format=torch.channels_last)
            torch.cuda.make_graphed_callables(
                trainer.network, (noisy, batch.planes.to(trainer.device))
            )

    def losses(self, trainer: Trainer) -> Iterator[Tensor]:
        """Of the next batch, which depends on nothing but the trainer's seed and step."""
        batch = self._batch(trainer)
        noisy = batch.noisy.to(trainer.device, memory_format=torch.channels_last)
        clean, planes, error = (
            each.to(trainer.device) for each in (batch.clean, batch.planes, batch.error)
        )
        missed = (trainer.network(noisy, planes) - clean).abs().mean(dim=(1, 2, 3))
        yield (missed / error.clamp_min(_SIGMAS[0])).mean()

    def _batch(self, trainer: Trainer) -> Batch:
        if self._threads is None:
            return noisy_batch(self.pool, trainer.random(), trainer.schedule)
        for step in range(trainer.step, min(trainer.step + _AHEAD, trainer.schedule.steps)):
            if step not in self._coming:
                self._coming[step] = self._threads.submit(
                    noisy_batch, self.pool, trainer.random(step), trainer.schedule
                )
        return self._coming.pop(trainer.step).result()
