"""Odd linear splines of many channels, such as the slopes of a regulariser's potentials."""

import importlib

import torch
from torch import Tensor


def odd_spline_(t: Tensor, knots: Tensor, masses: Tensor) -> Tensor:
    r"""Σ m min(max(t, −τ), τ) over the knots τ; t may be overwritten.

    Parameters
    ----------
    t
        (count, channels, height, width).
    knots, masses
        τ and m, (knots, count or 1, channels, 1, 1).
    """
    tensors = (t, knots, masses)
    compiled = (
        t.device.type == "cpu"
        and t.is_contiguous(memory_format=torch.channels_last)
        and all(each.dtype == torch.float32 for each in tensors)
        and not (torch.is_grad_enabled() and any(each.requires_grad for each in tensors))
    )
    if compiled:
        on_cpu = importlib.import_module("nolens.kernels.spline_numba")
        result: Tensor = on_cpu.odd_spline_(t, knots, masses)
        return result
    total = torch.zeros_like(t)
    for knot, mass in zip(knots, masses, strict=True):
        total = torch.addcmul(total, mass, torch.clamp(t, -knot, knot))
    return total
