r"""The split u = Ψv of differences, with its multipliers, of ADMM that fits in its linear step.

With a = u + d, the split with its scaled multiplier, and the proximal map u = prox(a) of the
variation, an iteration adds the pull of q = 2u − a to what the linear step solves for and moves
a ← a + α(Ψv − u). Differences are those to the next pixel along each side, around the end.

On the CPU each is one compiled pass over memory; elsewhere torch takes some rows at a time, as u of
all of them would be the most that a run holds.
"""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from types import ModuleType

import torch
from torch import Tensor

OPPONENTS = torch.tensor([[1.0, 1, 1], [1, 0, -1], [1, -2, 1]], dtype=torch.float64)
"""Opponent colours, of unit length: mean, red against blue, green against both."""
OPPONENTS /= torch.linalg.vector_norm(OPPONENTS, dim=1, keepdim=True)

_BAND = 4_000_000
"""Pixels whose differences torch maps at once."""


class Coupling(IntEnum):
    """Which differences are shrunk together."""

    NONE = 0
    """Each by itself: anisotropic total variation."""
    DIRECTIONS = 1
    """Those of a pixel: isotropic."""
    COLOURS = 2
    """Of three channels, those of opponent colours, each by itself."""


@dataclass(frozen=True)
class Shrinkage:
    """The proximal map of a variation, and the variation.

    Parameters
    ----------
    coupling
        Which differences it takes together.
    step
        Of the map.
    weights
        Of the ℓ1 norms of `OPPONENTS`.
    """

    coupling: Coupling
    step: float
    weights: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def of(self, a: Tensor) -> Tensor:
        """The map of (channels, 2, height, width)."""
        if self.coupling is Coupling.DIRECTIONS:
            length = torch.hypot(a[:, :1], a[:, 1:]).clamp_min_(self.step)
            return a * (1 - self.step / length)
        opponents = self._opponents(a)
        most = self.step * self._weights(a)
        return self._opponents(opponents - opponents.clamp(-most, most), back=True)

    def variation(self, differences: Tensor) -> float:
        """Of (channels, 2, height, width)."""
        if self.coupling is Coupling.DIRECTIONS:
            return float(torch.hypot(differences[:, 0], differences[:, 1]).sum(dtype=torch.float64))
        sums = self._opponents(differences).abs_().mul_(self._weights(differences))
        return float(sums.sum(dtype=torch.float64))

    def _opponents(self, a: Tensor, *, back: bool = False) -> Tensor:
        if self.coupling is Coupling.NONE:
            return a
        turned: Tensor = torch.tensordot((OPPONENTS.T if back else OPPONENTS).to(a), a, dims=1)
        return turned

    def _weights(self, a: Tensor) -> Tensor:
        return a.new_tensor(self.weights if self.coupling is Coupling.COLOURS else [1.0])[
            :, None, None, None
        ]


def add_pulls_(targets: Tensor, a: Tensor, shrinkage: Shrinkage, penalty: float) -> None:
    """Add penalty · Ψ*(2u − a) to targets.

    Parameters
    ----------
    targets
        (channels, height, width).
    a
        (channels, 2, height, width).
    shrinkage
        What u is.
    penalty
        Of the split.
    """
    if _compiled(a):
        _on_cpu().add_pulls_(targets, a, shrinkage, penalty)
        return
    for rows in _bands(a):
        part = a[..., rows, :]
        _add_back_(targets, (2 * shrinkage.of(part) - part).mul_(penalty), rows)


def move_differences_(
    a: Tensor, scenes: Tensor, shrinkage: Shrinkage, relaxation: float, *, counted: bool
) -> tuple[list[list[float]], float]:
    """Add α (Ψv − u) to a.

    Parameters
    ----------
    a
        (channels, 2, height, width).
    scenes
        V, (channels, height, width).
    shrinkage
        What u is.
    relaxation
        α.
    counted
        Whether sums are needed; they are zero otherwise.

    Returns
    -------
    list
        Of every channel, Σ(Ψv − u)², Σu², Σ(u − u_before)² and Σ(d − d_before)².
    float
        The variation of all Ψv together.
    """
    if _compiled(a):
        moved: tuple[list[list[float]], float] = _on_cpu().move_differences_(
            a, scenes, shrinkage, relaxation, counted=counted
        )
        return moved
    sums, variation = torch.zeros(len(a), 4, dtype=torch.float64), 0.0
    for rows in _bands(a):
        part, varied = a[..., rows, :], difference_rows(scenes, rows)
        u_then = shrinkage.of(part)
        if not counted:
            part.add_(varied.sub_(u_then), alpha=relaxation)
            continue
        d_then = part - u_then
        part.add_(varied - u_then, alpha=relaxation)
        u = shrinkage.of(part)
        turned = (part - u).sub_(d_then)
        parts = [
            each.square().sum(dim=(-3, -2, -1), dtype=torch.float64)
            for each in (varied - u, u, u - u_then, turned)
        ]
        sums += torch.stack(parts, -1).cpu()
        variation += shrinkage.variation(varied)
    return sums.tolist(), variation


def scale_multipliers_(a: Tensor, shrinkage: Shrinkage, factor: float) -> None:
    """Make u + factor · d of a = u + d.

    Parameters
    ----------
    a
        (channels, 2, height, width).
    shrinkage
        What u is.
    factor
        Of the multipliers.
    """
    if _compiled(a):
        _on_cpu().scale_multipliers_(a, shrinkage, factor)
        return
    for rows in _bands(a):
        part = a[..., rows, :]
        part.copy_(torch.lerp(shrinkage.of(part), part, factor))


def difference_rows(scene: Tensor, rows: slice) -> Tensor:
    """Some rows of Ψv, (..., 2, rows, width).

    Parameters
    ----------
    scene
        (..., height, width).
    rows
        From one to another, without a step.
    """
    inside = scene[..., rows, :]
    below = torch.cat([inside[..., 1:, :], scene[..., rows.stop % scene.shape[-2], None, :]], -2)
    return torch.stack([below - inside, inside.roll(-1, -1) - inside], dim=-3)


def _on_cpu() -> ModuleType:
    return importlib.import_module("nolens.kernels.differences_numba")


def _compiled(a: Tensor) -> bool:
    return a.device.type == "cpu" and a.dtype == torch.float32 and a.is_contiguous()


def _bands(a: Tensor) -> Iterator[slice]:
    height, width = a.shape[-2:]
    step = max(1, _BAND // width)
    for first in range(0, height, step):
        yield slice(first, min(first + step, height))


def _add_back_(targets: Tensor, differences: Tensor, rows: slice) -> None:
    """Add Ψ* of differences, (channels, 2, rows, width), that are zero on other rows."""
    down, right = differences.unbind(1)
    inside = targets[:, rows]
    inside += (right.roll(1, -1) - right).sub_(down)
    inside[:, 1:] += down[:, :-1]
    targets[:, rows.stop % targets.shape[1]] += down[:, -1]
