"""Patches of pictures to train on: crops, turned, mirrored, tinted, of any brightness."""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.progress import ProgressCallback
from nolens.training.pictures import training_picture

_SIDE = 256
"""Of generated pictures."""
_PHOTOGRAPHS = 0.4
"""Fraction of the patches that are of photographs, where there are any."""
_GREY = 0.15
"""Fraction of the patches whose channels are the same."""
_TINT, _WHITE = 0.15, (88.0, 99.9)
"""Deviation of the logarithm of a tint; percentiles that may be a photograph's white."""


@dataclass(frozen=True)
class PicturePool:
    """Pictures to cut patches from.

    Parameters
    ----------
    generated
        (count, 3, side, side), float16.
    photographs
        Each (3, height, width) in linear light of any scale, float32.
    """

    generated: Tensor = field(repr=False)
    photographs: tuple[Tensor, ...] = field(default=(), repr=False)

    @classmethod
    def generate(
        cls,
        count: int,
        seed: int,
        photographs: Sequence[Tensor] = (),
        progress: ProgressCallback | None = None,
    ) -> "PicturePool":
        """So many generated pictures, and these photographs.

        Parameters
        ----------
        count
            Of generated pictures.
        seed
            They depend on nothing else.
        photographs
            Linear light, (3, height, width); none smaller than a patch is of any use.
        progress
            Called with the fraction that is done.
        """
        pictures = torch.empty(count, 3, _SIDE, _SIDE, dtype=torch.float16)

        def generated(number: int) -> None:
            pictures[number] = training_picture(_SIDE, _SIDE, seed * 1_000_003 + number)

        with ThreadPoolExecutor(os.cpu_count()) as threads:
            for number, _ in enumerate(threads.map(generated, range(count))):
                if progress is not None:
                    progress((number + 1) / count)
        return cls(pictures, tuple(photographs))

    def patches(self, random: np.random.Generator, count: int, side: int) -> Tensor:
        """Patches, float32, (count, 3, side, side), from 0 to 1.

        Parameters
        ----------
        random
            All that is random comes from it.
        count, side
            How many, and of how many pixels along a side.
        """
        return torch.stack([self._patch(random, side) for _ in range(count)])

    def _patch(self, random: np.random.Generator, side: int) -> Tensor:
        usable = [each for each in self.photographs if min(each.shape[1:]) >= side]
        if usable and random.random() < _PHOTOGRAPHS:
            patch = photograph_patch(random, usable[random.integers(len(usable))], side)
        else:
            picture = self.generated[int(random.integers(len(self.generated)))]
            patch = _crop(random, picture, side).float()
        patch = torch.rot90(patch, int(random.integers(4)), (1, 2))
        if random.random() < 0.5:
            patch = patch.flip(2)
        tint = np.exp(random.normal(0, _TINT, (3, 1, 1))) * random.uniform(0.5, 1.1)
        patch = (patch * torch.from_numpy(tint.astype(np.float32))).clamp(0, 1)
        return (
            patch.mean(dim=0, keepdim=True).expand(3, -1, -1) if random.random() < _GREY else patch
        )


def photograph_patch(random: np.random.Generator, photograph: Tensor, side: int) -> Tensor:
    """A crop at its own size or half of it, exposed so that some of it may be white.

    Parameters
    ----------
    random
        All that is random comes from it.
    photograph
        (3, height, width) in linear light of any scale.
    side
        Pixels of the patch along a side.
    """
    if min(photograph.shape[1:]) >= 2 * side and random.random() < 0.4:
        cut = nnf.avg_pool2d(_crop(random, photograph, 2 * side), 2)
    else:
        cut = _crop(random, photograph, side)
    white = np.percentile(cut.numpy(), random.uniform(*_WHITE))
    return (cut / max(float(white), 1e-6)).clamp(0, 1)


def _crop(random: np.random.Generator, picture: Tensor, side: int) -> Tensor:
    top, left = (int(random.integers(0, have - side + 1)) for have in picture.shape[1:])
    return picture[:, top : top + side, left : left + side]
