"""The passes of ADMM as torch operations: what runs on CUDA, and the check on the CPU's."""

import math

import torch
from torch import Tensor

Triple = tuple[float, float, float]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
    """See `nolens.kernels.admm.solve_normal_equation_`."""
    mu_x, mu_u, mu_w = penalties
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
    prior: tuple[float, bool, float],
    step: tuple[Triple, Triple, float],
) -> tuple[Tensor, list[float]]:
    """See `nolens.kernels.admm.update_splits_`."""
    tv, isotropic, l1 = prior
    mu, later, alpha = step
    rescale = [now / next_ if next_ > 0 else 1.0 for now, next_ in zip(mu, later, strict=True)]
    v, mv = pair.real.clone(), pair.imag.clone()
    table = torch.zeros(4, 3, dtype=torch.float64, device=pair.device)

    top, left, height, width = windows[0]
    data = torch.zeros_like(mv)
    weight = torch.zeros_like(mv)
    weight[top : top + height, left : left + width] = measurement[1].to(mv.dtype)
    data[top : top + height, left : left + width] = measurement[0]
    data *= weight
    old = [(data + mu[0] * arrays[0]) / (weight + mu[0])]
    new = [arrays[0] + alpha * (mv - old[0])]
    split = [(data + mu[0] * new[0]) / (weight + mu[0])]
    q = _store([mv], [arrays[0]], old, new, split, rescale[0], table[:, 0])[0]
    misfit = (weight * mv - data).double().square().sum()

    top, left, height, width = windows[1]
    inside = torch.zeros_like(v)
    inside[top : top + height, left : left + width] = 1
    old = [inside * (arrays[3] - l1 / mu[2]).clamp_min(0)]
    new = [arrays[3] + alpha * (v - old[0])]
    split = [inside * (new[0] - l1 / mu[2]).clamp_min(0)]
    r = later[2] * _store([v], [arrays[3]], old, new, split, rescale[2], table[:, 2])[0]
    magnitude = v.double().abs().sum()

    variation = torch.zeros((), dtype=torch.float64, device=pair.device)
    if tv > 0:
        gradient = [torch.roll(v, -1, 0) - v, torch.roll(v, -1, 1) - v]
        state = [arrays[1], arrays[2]]
        old = _shrink(state, tv / mu[1], isotropic)
        new = [a + alpha * (g - u) for a, g, u in zip(state, gradient, old, strict=True)]
        split = _shrink(new, tv / mu[1], isotropic)
        q_y, q_x = _store(gradient, state, old, new, split, rescale[1], table[:, 1])
        r += later[1] * (torch.roll(q_y, 1, 0) - q_y + torch.roll(q_x, 1, 1) - q_x)
        size = torch.hypot(*gradient) if isotropic else gradient[0].abs() + gradient[1].abs()
        variation = size.double().sum()
    extra = torch.stack([misfit, variation, magnitude])
    sums = torch.cat([table.flatten(), extra]).tolist()
    return torch.complex(q, r), sums


def _laplacian(length: int, like: Tensor) -> Tensor:
    k = torch.arange(length, dtype=torch.float64, device=like.device)
    return (4 * torch.sin(math.pi * k / length) ** 2).to(like.real.dtype)


def _shrink(arrays: list[Tensor], threshold: float, isotropic: bool) -> list[Tensor]:
    if isotropic:
        size = torch.hypot(*arrays)
        scale = (size - threshold).clamp_min(0) / size.clamp_min(1e-30)
        return [scale * a for a in arrays]
    return [a.sign() * (a.abs() - threshold).clamp_min(0) for a in arrays]


def _store(
    field: list[Tensor],
    state: list[Tensor],
    old: list[Tensor],
    new: list[Tensor],
    split: list[Tensor],
    rescale: float,
    sums: Tensor,
) -> list[Tensor]:
    """Write the state of the next iteration, add up the sums, return q = 2x - a."""
    q = []
    for kv, a, x_old, a_new, x in zip(field, state, old, new, split, strict=True):
        multiplier = a_new - x
        parts = (kv - x, x, x - x_old, multiplier - (a - x_old))
        for k, part in enumerate(parts):
            sums[k] += part.double().square().sum()
        a.copy_(x + rescale * multiplier)
        q.append(2 * x - a)
    return q
