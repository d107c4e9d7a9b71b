"""Small networks and few pictures, for tests that train."""

import torch

from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.training.denoising import NoiseLessons, Schedule, Trainer
from nolens.training.patches import PicturePool


def tiny_network(seed: int = 0) -> DenoisingNetwork:
    torch.manual_seed(seed)
    return DenoisingNetwork((8, 8), (1, 1))


def trainer(steps: int, seed: int = 0, rate: float = 1e-2) -> Trainer:
    schedule = Schedule(steps, rate, patches=6, side=32)
    return Trainer(tiny_network(), schedule, seed)


def noise_lessons() -> NoiseLessons:
    return NoiseLessons(PicturePool.generate(2, 0))
