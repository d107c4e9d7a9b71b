"""Field points along one side of a scene, and the linear weights between them."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor


def nodes(length: int, count: int) -> list[int]:
    """Pixels of the field points along one side: the middle, or from edge to edge."""
    count = min(count, length - 1 + length % 2)
    if count == 1:
        return [length // 2]
    return [round(i * (length - 1) / (count - 1)) for i in range(count)]


@dataclass(frozen=True)
class Edges:
    """Pixels beyond the sensor, on both sides, at which the PSF of each node is needed.

    A pixel r before its node (r < 0) sees the sensor's last pixel through the PSF's pixel that lies
    |r| beyond it; so the gap to the node before counts after the sensor, and the other way round.
    """

    before: list[int]
    after: list[int]

    @classmethod
    def of(cls, nodes: list[int], length: int) -> "Edges":
        """Count them for all nodes of a side with so many pixels."""
        if len(nodes) == 1:
            return cls([length - 1 - nodes[0]], [nodes[0]])
        gaps = [after - before for before, after in pairwise(nodes)]
        return cls([*gaps, 0], [0, *gaps])

    def at(self, index: int) -> tuple[int, int]:
        """Before and after the sensor, for one node."""
        return self.before[index], self.after[index]


def hat(nodes: list[int], index: int, length: int) -> Tensor:
    """Linear weight of one node: 1 at its pixel, 0 from its neighbours on."""
    if len(nodes) == 1:
        return torch.ones(length)
    cells = torch.arange(length, dtype=torch.float32)
    rising = torch.ones(length)
    if index > 0:
        rising = (cells - nodes[index - 1]) / (nodes[index] - nodes[index - 1])
    falling = torch.ones(length)
    if index + 1 < len(nodes):
        falling = (nodes[index + 1] - cells) / (nodes[index + 1] - nodes[index])
    return torch.minimum(rising, falling).clamp(0, 1)
