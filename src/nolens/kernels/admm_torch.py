"""The passes of ADMM as torch operations: CUDA without Triton, and the check on the others."""

import math

import torch
from torch import Tensor

Triple = tuple[float, float, float]


def step_constants(
    prior: tuple[float, bool, float], step: tuple[Triple, Triple, float]
) -> list[float]:
    """Constants of an update: μ of (x, u, w), their following values, their ratios, α, τ and λ.

    Parameters
    ----------
    prior
        τ, whether it is isotropic, λ.
    step
        Penalties, those of the next iteration, α.
    """
    tv, _, l1 = prior
    penalties, following, relaxation = step
    # With no penalty on a split its multiplier is absent, and 0/0 would be the rescaling.
    rescale = [
        now / later if later > 0 else 1.0 for now, later in zip(penalties, following, strict=True)
    ]
    return [*penalties, *following, *rescale, relaxation, tv, l1]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, constants: Tensor) -> Tensor:
    """See `nolens.kernels.admm.solve_normal_equation_`; the constants begin with μ₁, μ₂, μ₃."""
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
    pair: Tensor,
    measurement: tuple[Tensor, Tensor],
    arrays: tuple[Tensor, Tensor, Tensor, Tensor],
    windows: tuple[tuple[int, int, int, int], tuple[int, int, int, int]],
    kind: tuple[bool, bool],
    constants: Tensor,
    *,
    counted: bool,
    out: Tensor,
) -> list[float] | None:
    """Update every split as `nolens.kernels.admm.update_splits_` says; returns the sums.

    Parameters
    ----------
    pair
        v + i Mv.
    measurement
        Data, and 1 where they are valid.
    arrays
        State of the splits x, u (two directions, empty without total variation) and w.
    windows
        Where the sensor and the region lie.
    kind
        Whether there is a total variation, and whether it is isotropic.
    constants
        `step_constants` on the device, so that a CUDA graph reads what they are at its replay.
    counted
        Whether the sums are wanted.
    out
        Where q_x + i r goes; `pair` itself may be.
    """
    tv, isotropic = kind
    mu, later, rescale = constants[0:3], constants[3:6], constants[6:9]
    alpha, tau, l1 = constants[9:]
    v, mv = pair.real.clone(), pair.imag.clone()
    table = torch.zeros(4, 3, dtype=torch.float64, device=pair.device) if counted else None

    top, left, height, width = windows[0]
    data = torch.zeros_like(mv)
    weight = torch.zeros_like(mv)
    weight[top : top + height, left : left + width] = measurement[1].to(mv.dtype)
    data[top : top + height, left : left + width] = measurement[0]
    data *= weight
    old = [(data + mu[0] * arrays[0]) / (weight + mu[0])]
    new = [arrays[0] + alpha * (mv - old[0])]
    split = [(data + mu[0] * new[0]) / (weight + mu[0])]
    q = _store([mv], [arrays[0]], old, new, split, rescale[0], _column(table, 0))[0]

    top, left, height, width = windows[1]
    inside = torch.zeros_like(v)
    inside[top : top + height, left : left + width] = 1
    old = [inside * (arrays[3] - l1 / mu[2]).clamp_min(0)]
    new = [arrays[3] + alpha * (v - old[0])]
    split = [inside * (new[0] - l1 / mu[2]).clamp_min(0)]
    r = later[2] * _store([v], [arrays[3]], old, new, split, rescale[2], _column(table, 2))[0]

    gradient = [torch.roll(v, -1, 0) - v, torch.roll(v, -1, 1) - v] if tv else []
    if tv:
        state = [arrays[1], arrays[2]]
        old = _shrink(state, tau / mu[1], isotropic)
        new = [a + alpha * (g - u) for a, g, u in zip(state, gradient, old, strict=True)]
        split = _shrink(new, tau / mu[1], isotropic)
        q_y, q_x = _store(gradient, state, old, new, split, rescale[1], _column(table, 1))
        r += later[1] * (torch.roll(q_y, 1, 0) - q_y + torch.roll(q_x, 1, 1) - q_x)
    torch.complex(q, r, out=out)
    if table is None:
        return None
    misfit = (weight * mv - data).double().square().sum()
    magnitude = v.double().abs().sum()
    extra = torch.stack([misfit, _variation(gradient, isotropic, like=misfit), magnitude])
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
