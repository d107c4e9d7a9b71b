"""Training of the ridge regulariser, as a denoiser: through the minimum that it finds."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from nolens.solvers.ridge import FilterBank, Potentials, RidgeWeights, largest_gain, opponents
from nolens.training.patches import PicturePool

_SIGMAS = 0.01, 0.3
"""Weakest and strongest noise, of a white of 1."""
_POWER = 1.3
"""A good denoiser's squared error grows as σ to that; over it, errors of all noise count alike."""
_GREY_EVERY = 4
"""One of so many batches has one plane only."""
_BASES, _KNOTS = 8, 5
_WIDE, _NARROW = 7, 3
_GRID = 32
_DESCENT, _CONJUGATE = 20, 8
"""Steps to the minimum, and of conjugate gradients back from it."""
_DECAY = 0.998
_CLIP = 1.0


class RidgeParameters(nn.Module):
    """What the weights are made of: filters of any norm, everything else as it is stored.

    Parameters
    ----------
    seed
        Of the first values.
    """

    def __init__(self, seed: int) -> None:
        super().__init__()
        generator = torch.Generator().manual_seed(seed)

        def noise(*shape: int) -> Tensor:
            return torch.randn(shape, generator=generator)

        atoms = _cosine_atoms(_NARROW)
        count = _BASES * len(atoms)
        filters = 0.02 * noise(count, _BASES, _NARROW, _NARROW)
        for base in range(_BASES):
            filters[base * len(atoms) : (base + 1) * len(atoms), base] += atoms
        spread = filters.new_tensor([0.15, 0.3, 0.7, 1.2, 3.0])
        self.bases = nn.Parameter(_first_bases() + 0.01 * noise(_BASES, 3, _WIDE, _WIDE))
        self.filters = nn.Parameter(filters)
        self.knots = nn.Parameter(spread.log().expand(count, _KNOTS).clone())
        bends = filters.new_tensor([0.0, -1.5, -2.6, -3.0, -2.6])
        self.bends = nn.Parameter(bends.expand(count, _KNOTS).clone())
        self.trends = nn.Parameter(torch.zeros(count, 2))

    def weights(self) -> RidgeWeights:
        """With filters of the mean 0 and the norm 1; with gradients."""
        filters = self.filters - self.filters.mean(dim=(2, 3), keepdim=True)
        norm = largest_gain(self.bases, filters, _GRID).sqrt()
        return RidgeWeights(self.bases, filters / norm, self.knots, self.bends, self.trends)


@dataclass(frozen=True)
class RidgeSchedule:
    """How long and how fast it learns.

    Parameters
    ----------
    steps
        Number of batches.
    rate
        Largest step of Adam; it rises over a fortieth of the steps and falls as a cosine.
    patches, side
        Of a batch: how many, and their pixels along a side.
    """

    steps: int
    rate: float = 4e-3
    patches: int = 8
    side: int = 40

    def rate_at(self, step: int) -> float:
        """Step of Adam at a batch."""
        fallen = 0.5 * (1 + math.cos(math.pi * min(step / self.steps, 1.0)))
        return self.rate * min((step + 1) / max(self.steps // 40, 1), 1.0) * max(fallen, 0.01)


class RidgeTrainer:
    r"""Parameters, their optimiser and their mean over the steps: all that a checkpoint holds.

    The picture is x(y) = argmin ½‖x − y‖² + R(x). Where the loss has the gradient g at x, that by
    the parameters θ is

    .. math:: -\partial_θ \langle u, \nabla R_θ(x) \rangle, \qquad (1 + \nabla^2 R(x))\, u = g,

    which conjugate gradients solve (implicit differentiation, as in `goujon2024`).

    Parameters
    ----------
    schedule
        How long and how fast.
    seed
        Of first values and batches.
    """

    def __init__(self, schedule: RidgeSchedule, seed: int) -> None:
        self.schedule, self.seed, self.step = schedule, seed, 0
        self.parameters = RidgeParameters(seed)
        self._optimiser = torch.optim.Adam(self.parameters.parameters(), lr=schedule.rate)
        self._mean = {name: each.clone() for name, each in self.parameters.state_dict().items()}

    def learn(self, pool: PicturePool) -> float:
        """One step, with patches of a pool; the loss."""
        noisy, sigma, clean = self._batch(pool)
        for group in self._optimiser.param_groups:
            group["lr"] = self.schedule.rate_at(self.step)
        bank, potentials = self._at(sigma, clean)
        x = _minimum(bank, potentials, noisy)
        error, scale = x - clean, sigma ** (2 - _POWER)
        loss = float((error.square() * scale).mean())
        u = _back(bank, potentials, x, 2 * error * scale / error.numel())
        self._optimiser.zero_grad(set_to_none=True)
        product = -(bank(u) * potentials.slope_(bank(x))).sum()
        product.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(self.parameters.parameters(), _CLIP)
        self._optimiser.step()
        self.step += 1
        decay = min(_DECAY, (1 + self.step) / (10 + self.step))
        with torch.no_grad():
            for name, each in self.parameters.state_dict().items():
                self._mean[name].lerp_(each, 1 - decay)
        return loss

    def loss(self, pool: PicturePool) -> float:
        """That of the next batch."""
        noisy, sigma, clean = self._batch(pool)
        bank, potentials = self._at(sigma, clean)
        error = _minimum(bank, potentials, noisy) - clean
        return float((error.square() * sigma ** (2 - _POWER)).mean())

    def _at(self, sigma: Tensor, planes: Tensor) -> tuple[FilterBank, Potentials]:
        """Filters and potentials of the present parameters, with gradients."""
        weights = self.parameters.weights()
        bank = FilterBank(weights.bases[:, : planes.shape[1]], weights.filters)
        return bank, weights.potentials(sigma.flatten())

    def trained(self) -> RidgeWeights:
        """The weights of the mean parameters."""
        parameters = RidgeParameters(self.seed)
        parameters.load_state_dict(self._mean)
        with torch.no_grad():
            weights = parameters.weights()
        return RidgeWeights.from_arrays(weights.arrays())

    def state(self) -> dict[str, object]:
        """All that `resume` needs."""
        return {
            "step": self.step,
            "seed": self.seed,
            "parameters": self.parameters.state_dict(),
            "mean": self._mean,
            "optimiser": self._optimiser.state_dict(),
        }

    def resume(self, state: dict[str, object]) -> None:
        """Go on from a `state`."""
        self.step, self.seed = int(state["step"]), int(state["seed"])  # type: ignore[call-overload]
        self.parameters.load_state_dict(state["parameters"])  # type: ignore[arg-type]
        self._mean = dict(state["mean"])  # type: ignore[call-overload]
        self._optimiser.load_state_dict(state["optimiser"])  # type: ignore[arg-type]

    def _batch(self, pool: PicturePool) -> tuple[Tensor, Tensor, Tensor]:
        """Opponent planes over σ with noise, σ, and planes without noise."""
        random = np.random.Generator(
            np.random.Philox(np.random.SeedSequence(self.seed, spawn_key=(3, self.step)))
        )
        schedule = self.schedule
        patches = pool.patches(random, schedule.patches, schedule.side)
        if self.step % _GREY_EVERY == _GREY_EVERY - 1:
            planes = patches[:, 1:2]
        else:
            planes = torch.einsum("pc,nchw->nphw", opponents().to(patches), patches)
        low, high = np.log(_SIGMAS)
        level = np.exp(random.uniform(low, high, (len(planes), 1, 1, 1)))
        sigma = torch.from_numpy(level.astype(np.float32))
        noise = torch.from_numpy(random.standard_normal(tuple(planes.shape), np.float32))
        clean = planes / sigma
        return clean + noise, sigma, clean


@torch.no_grad()
def _minimum(
    bank: FilterBank, potentials: Potentials, noisy: Tensor, steps: int = _DESCENT
) -> Tensor:
    """Where ½‖x − y‖² + R(x) is about least."""
    rate = 1 / (1 + potentials.steepest)
    x = ahead = noisy
    momentum = torch.ones(len(noisy), 1, 1, 1)
    for _ in range(steps):
        before = x
        x = ahead - rate * (ahead - noisy + bank.adjoint(potentials.slope_(bank(ahead))))
        uphill = ((ahead - x) * (x - before)).sum(dim=(1, 2, 3), keepdim=True) > 0
        momentum = torch.where(uphill, 1.0, momentum)
        following = (1 + (1 + 4 * momentum.square()).sqrt()) / 2
        ahead, momentum = x + (momentum - 1) / following * (x - before), following
    return x


@torch.no_grad()
def _back(bank: FilterBank, potentials: Potentials, x: Tensor, slope: Tensor) -> Tensor:
    """(1 + W*ψ″W)⁻¹ of the loss's gradient, picture by picture, by conjugate gradients."""
    bend = potentials.bend(bank(x))

    def dot(a: Tensor, b: Tensor) -> Tensor:
        return (a * b).sum(dim=(1, 2, 3), keepdim=True)

    u, left = torch.zeros_like(slope), slope
    direction, size = left, dot(left, left)
    for _ in range(_CONJUGATE):
        image = direction + bank.adjoint(bend * bank(direction))
        length = size / dot(direction, image).clamp_min(1e-30)
        u, left = u + length * direction, left - length * image
        before, size = size, dot(left, left)
        direction = left + size / before.clamp_min(1e-30) * direction
    return u


def _cosine_atoms(side: int) -> Tensor:
    """Products of cosines along both axes, of unit norm, but for the constant."""
    place = (torch.arange(side) + 0.5) / side
    waves = torch.cos(math.pi * torch.arange(side)[:, None] * place)
    waves = waves / torch.linalg.vector_norm(waves, dim=1, keepdim=True)
    atoms: Tensor = torch.einsum("ai,bj->abij", waves, waves).flatten(0, 1)[1:]
    return atoms


def _first_bases() -> Tensor:
    """Pixels and Gaussians of each plane."""
    place = torch.arange(_WIDE) - _WIDE // 2
    squares = place[:, None].square() + place.square()
    bases = torch.zeros(_BASES, 3, _WIDE, _WIDE)
    widths = ((0, 0.3), (0, 0.8), (0, 1.4), (0, 2.2), (1, 0.3), (1, 1.5), (2, 0.3), (2, 1.5))
    for number, (plane, width) in enumerate(widths):
        blob = torch.exp(-squares / (2 * width**2))
        bases[number, plane] = blob / torch.linalg.vector_norm(blob)
    return bases
