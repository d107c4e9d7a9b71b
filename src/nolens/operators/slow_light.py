"""Slow cosines, and what is left of an image without them."""

import math

import torch
from torch import Tensor

from nolens.operators.base import LinearOperator

MODES = 3
"""Slow cosines along each side."""


class SlowLightRemoval(LinearOperator):
    r"""Valid pixels without the slowest parts of the light on them, except for their mean.

    An orthogonal projection, with V the valid pixels:

    .. math:: R = V - V C (C^* V C)^{-1} C^* V,

    where the columns of C are products of `slow_cosines` along both sides, each without its mean
    over the valid pixels. A model's errors are there: the sensor gets less light from the side,
    and a little less on one edge than on the other, which one PSF does not know. The slow part of a
    scene can be told from the detail of the light as well, but hardly its mean.

    Parameters
    ----------
    valid
        (channels, height, width), bool.
    """

    def __init__(self, valid: Tensor) -> None:
        self.valid, self._all_valid = valid, bool(valid.all())
        height, width = valid.shape[-2:]
        self._rows, self._columns = (
            slow_cosines(side).to(valid.device) for side in (height, width)
        )
        self._inverse = torch.stack([self._projection(each) for each in valid])

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Shape of the valid pixels."""
        return tuple(self.valid.shape)

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Shape of the valid pixels."""
        return tuple(self.valid.shape)

    def _forward(self, v: Tensor) -> Tensor:
        valid = v if self._all_valid else torch.where(self.valid, v, 0)
        rows, columns = self._rows.to(v), self._columns.to(v)
        along = (rows @ valid @ columns.T).flatten(-2)[..., None]
        amounts = (self._inverse.to(v) @ along).view(*along.shape[:-2], len(rows), len(columns))
        left, slow = torch.empty_like(valid), (rows.T @ amounts).flatten(0, -3)
        for plane, each, part in zip(left.flatten(0, -3), valid.flatten(0, -3), slow, strict=True):
            torch.addmm(each, part, columns, alpha=-1, out=plane)
        return left if self._all_valid else left.mul_(self.valid)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self._forward(y)

    def _projection(self, valid: Tensor) -> Tensor:
        """From inner products with the cosines to amounts of them, the mean not counted."""
        rows, columns = (
            (each[:, None] * each).flatten(0, 1) for each in (self._rows, self._columns)
        )
        count, most = len(self._rows), len(self._columns)
        # Of products of cosines, sums over the valid pixels: a row and a column at a time.
        sums = rows @ valid.to(rows) @ columns.T
        products = sums.view(count, count, most, most).transpose(1, 2).reshape(count * most, -1)
        apart = torch.eye(len(products)).to(products)[:, 1:]
        mean = products[0] / products[0, 0].clamp_min(torch.finfo(products.dtype).tiny)
        apart[0] -= mean[1:]
        inverse: Tensor = torch.linalg.pinv(apart.T @ products @ apart, hermitian=True)
        return apart @ inverse @ apart.T


def slow_cosines(count: int) -> Tensor:
    """Cosines of 0, 1, … half waves along `count` pixels, of unit norm; float64."""
    place = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    modes = torch.arange(min(MODES, count), dtype=torch.float64)
    waves = torch.cos(math.pi * modes[:, None] * place)
    unit: Tensor = waves / torch.linalg.vector_norm(waves, dim=1, keepdim=True)
    return unit


def slow_waves(count: int, period: int) -> Tensor:
    """Orthonormal rows that sines and cosines of `slow_cosines` along `period` are sums of.

    Any convolution of such a cosine is one on `count` pixels, as far as it sees neither end.

    Parameters
    ----------
    count
        Pixels of the rows.
    period
        Pixels that the cosines are along.
    """
    place = (torch.arange(count, dtype=torch.float64) + 0.5 - count / 2) / period
    modes = torch.arange(1, min(MODES, period), dtype=torch.float64)
    turns = math.pi * modes[:, None] * place
    waves = torch.cat([torch.ones_like(place)[None], torch.cos(turns), torch.sin(turns)])
    unit: Tensor = torch.linalg.qr(waves.T).Q.T
    return unit
