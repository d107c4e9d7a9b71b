"""A spectrum times the transfer function of plane layers, in place.

The phase is a sum of square roots of some ten thousand turns of which the fraction counts, so it
is computed in float64. On the CPU that is one compiled pass over the rows; on CUDA, torch.
"""

import importlib
import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

_LEAST = 1e-12
"""Of n² − p², so that grazing light, of which nothing passes, divides by no zero."""


@dataclass(frozen=True)
class LayerTransfer:
    r"""The transfer function :math:`e^{2πi(Σ_j l_j\sqrt{n_j^2 - p^2} + a_r + a_c)}` of layers.

    It is 0 from p² = limit on, and times the root of the power that passes the surfaces between
    media: for unpolarised light :math:`2ab\,[(a + b)^{-2} + (fa + b/f)^{-2}]` at each, with
    :math:`a, b = \sqrt{n^2 - p^2}` of the medium before and after it, and :math:`f` the index after
    over that before (`goodman2005`).

    Parameters
    ----------
    transverse
        p of the rows and of the columns, float64, on the spectrum's device; infinite where
        nothing is to pass.
    linear_turns
        a_r of the rows and a_c of the columns, float64.
    lengths
        l: thickness / wavelength of every layer.
    squared_indices
        n² of every layer.
    limit
        Not above the smallest n², that of the media included.
    media
        n of the media in light's order, if losses at the surfaces between them count.
    """

    transverse: tuple[Tensor, Tensor]
    linear_turns: tuple[Tensor, Tensor]
    lengths: tuple[float, ...]
    squared_indices: tuple[float, ...]
    limit: float
    media: tuple[float, ...] = ()


def apply_transfer_(spectrum: Tensor, transfer: LayerTransfer) -> Tensor:
    """Multiply a spectrum, (rows, columns) of contiguous complex64, in place."""
    if spectrum.device.type != "cpu":
        return _on_device(spectrum, transfer)
    on_cpu = importlib.import_module("nolens.kernels.transfer_numba")
    result: Tensor = on_cpu.apply_transfer_(spectrum, transfer)
    return result


def _on_device(spectrum: Tensor, transfer: LayerTransfer) -> Tensor:
    """The same by torch, some rows at a time."""
    rows, columns = transfer.transverse
    row_turns, column_turns = transfer.linear_turns
    for first in range(0, len(spectrum), 512):
        part = slice(first, first + 512)
        squared = rows[part, None].square() + columns.square()
        turns = row_turns[part, None] + column_turns
        for length, index in zip(transfer.lengths, transfer.squared_indices, strict=True):
            turns += length * (index - squared).clamp_min(0).sqrt()
        passed = (squared < transfer.limit).float()
        if len(transfer.media) > 1:
            passed *= _power(squared.float(), transfer.media).sqrt()
        spectrum[part] *= torch.polar(passed, turns.frac().float() * (2 * math.pi))
    return spectrum


def _power(squared: Tensor, media: tuple[float, ...]) -> Tensor:
    """Fraction of the power that passes all surfaces."""
    power = torch.ones_like(squared)
    for before, after in pairwise(media):
        near, far = ((n * n - squared).clamp_min(_LEAST).sqrt() for n in (before, after))
        ratio = after / before
        power *= 2 * near * far * ((near + far) ** -2 + (ratio * near + far / ratio) ** -2)
    return power
