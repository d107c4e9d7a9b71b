"""The passes of ADMM as torch operations: CUDA without Triton, and the check on the others."""

import math

import torch
from torch import Tensor

from nolens.kernels.admm import SplitState


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, constants: Tensor) -> Tensor:
    """Solve as `nolens.kernels.admm.solve_normal_equation_` says, in place.

    Parameters
    ----------
    spectrum, transfer
        Of q_x + i r, and half that of the PSF.
    constants
        On the device, beginning with μ₁, μ₂, μ₃.
    """
    mu_x, mu_u, mu_w = constants[:3]
    height, width = spectrum.shape
    columns = width // 2 + 1
    here = spectrum[:, :columns]
    mirror = torch.roll(torch.flip(spectrum, (0, 1)), (1, 1), (0, 1)).conj()[:, :columns]
    measured = 0.5 * (here + mirror)
    rest = -0.5j * (here - mirror)
    laplacian = _laplacian(height, spectrum)[:, None] + _laplacian(width, spectrum)[:columns]
    scene = (mu_x * transfer.conj() * measured + rest) / (
        mu_x * transfer.abs().square() + mu_u * laplacian + mu_w
    )
    image = transfer * scene
    spectrum[:, :columns] = scene + 1j * image
    opposite = scene.conj() + 1j * image.conj()
    # Cells (i, j) with j past the middle are the mirrors of (-i, -j).
    inner = torch.flip(opposite[:, 1 : width - columns + 1], (0, 1))
    spectrum[:, columns:] = torch.roll(inner, 1, 0)
    return spectrum


def update_splits_(
    pair: Tensor, state: SplitState, constants: Tensor, *, counted: bool, out: Tensor
) -> list[float] | None:
    """Update every split as `nolens.kernels.admm.update_splits_` says; returns the sums.

    Parameters
    ----------
    pair
        v + i Mv.
    state
        Of the channel, updated.
    constants
        `nolens.kernels.admm.step_constants` on the device, so that a CUDA graph reads
        what they are at its replay.
    counted
        Whether the sums are needed.
    out
        Where q_x + i r goes; `pair` itself may be.
    """
    tv, isotropic = state.tv > 0, state.isotropic
    mu, later, rescale = constants[0:3], constants[3:6], constants[6:9]
    alpha, tau, l1 = constants[9:]
    v, mv = pair.real.clone(), pair.imag.clone()
    table = torch.zeros(4, 3, dtype=torch.float64, device=pair.device) if counted else None

    top, left, height, width = state.sensor
    data = torch.zeros_like(mv)
    weight = torch.zeros_like(mv)
    weight[top : top + height, left : left + width] = state.valid.to(mv.dtype)
    data[top : top + height, left : left + width] = state.data
    data *= weight
    old = [(data + mu[0] * state.measured) / (weight + mu[0])]
    new = [state.measured + alpha * (mv - old[0])]
    split = [(data + mu[0] * new[0]) / (weight + mu[0])]
    q = _store([mv], [state.measured], old, new, split, rescale[0], _column(table, 0))[0]

    top, left, height, width = state.support
    inside = torch.zeros_like(v)
    inside[top : top + height, left : left + width] = 1
    old = [inside * (state.scene - l1 / mu[2]).clamp_min(0)]
    new = [state.scene + alpha * (v - old[0])]
    split = [inside * (new[0] - l1 / mu[2]).clamp_min(0)]
    r = later[2] * _store([v], [state.scene], old, new, split, rescale[2], _column(table, 2))[0]

    gradient = [torch.roll(v, -1, 0) - v, torch.roll(v, -1, 1) - v] if tv else []
    if tv:
        arrays = [state.rows, state.columns]
        old = _shrink(arrays, tau / mu[1], isotropic)
        new = [a + alpha * (g - u) for a, g, u in zip(arrays, gradient, old, strict=True)]
        split = _shrink(new, tau / mu[1], isotropic)
        q_y, q_x = _store(gradient, arrays, old, new, split, rescale[1], _column(table, 1))
        r += later[1] * (torch.roll(q_y, 1, 0) - q_y + torch.roll(q_x, 1, 1) - q_x)
    torch.complex(q, r, out=out)
    if table is None:
        return None
    residual = (weight * mv - data).double().square().sum()
    magnitude = v.double().abs().sum()
    extra = torch.stack([residual, _variation(gradient, isotropic, like=residual), magnitude])
    sums: list[float] = torch.cat([table.flatten(), extra]).tolist()
    return sums


def _laplacian(length: int, like: Tensor) -> Tensor:
    k = torch.arange(length, dtype=torch.float64, device=like.device)
    return (4 * torch.sin(math.pi * k / length) ** 2).to(like.real.dtype)


def _shrink(arrays: list[Tensor], threshold: Tensor, isotropic: bool) -> list[Tensor]:
    if isotropic:
        size = torch.hypot(*arrays)
        scale = (size - threshold).clamp_min(0) / size.clamp_min(1e-30)
        return [scale * a for a in arrays]
    return [a.sign() * (a.abs() - threshold).clamp_min(0) for a in arrays]


def _variation(gradient: list[Tensor], isotropic: bool, like: Tensor) -> Tensor:
    if not gradient:
        return torch.zeros_like(like)
    size = torch.hypot(*gradient) if isotropic else gradient[0].abs() + gradient[1].abs()
    return size.double().sum()


def _column(table: Tensor | None, k: int) -> Tensor | None:
    return None if table is None else table[:, k]


def _store(
    field: list[Tensor],
    state: list[Tensor],
    old: list[Tensor],
    new: list[Tensor],
    split: list[Tensor],
    rescale: Tensor,
    sums: Tensor | None,
) -> list[Tensor]:
    """Write the state of the next iteration, add up the sums, return q = 2x - a."""
    q = []
    for kv, a, x_old, a_new, x in zip(field, state, old, new, split, strict=True):
        multiplier = a_new - x
        if sums is not None:
            parts = (kv - x, x, x - x_old, multiplier - (a - x_old))
            for k, part in enumerate(parts):
                sums[k] += part.double().square().sum()
        a.copy_(x + rescale * multiplier)
        q.append(2 * x - a)
    return q
