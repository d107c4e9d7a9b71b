r"""The two passes between the transforms of an ADMM iteration, on any device.

The iteration, in the Douglas-Rachford form of ADMM with over-relaxation (`eckstein1992`,
`boyd2011`), keeps one array `a` per split. With the splits x = Mv, u = Ψv, w = v, their
penalties μ and the proximal maps prox of the three terms of the objective,

    x = prox(a),  q = 2x - a,
    v = argmin Σ μ/2 ‖K v - q‖²          (`solve_normal_equation_`, in the Fourier domain)
    a ← a + α (K v - x)                  (`update_splits_`)

for every split K in {M, Ψ, 1}. The scaled multiplier is d = a - x, so nothing else is stored.
The two real fields that go into the transforms ride as real and imaginary part of one complex
field: (q_x, μ₂Ψᵀq_u + μ₃q_w) on the way there and (v, Mv) on the way back.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import admm_numba, admm_torch, solve_numba

Window = tuple[int, int, int, int]
"""top, left, height, width of a rectangle inside the period"""


@dataclass
class SplitState:
    """One channel's arrays and the constants of its objective.

    Parameters
    ----------
    data
        Measurement, (height, width) of the sensor.
    valid
        1 where the measurement takes part in the fit, 0 where a pixel is saturated; uint8.
    sensor, region
        Where the sensor, and the cells that light can come from, lie in the period.
    tv, isotropic, l1
        Weight of the total variation, its kind, and weight of the ℓ1 norm.
    measured, rows, columns, scene
        The arrays `a` of the splits x = Mv, u = Ψv (its two directions) and w = v, of the
        period's size. `rows` and `columns` are empty where `tv` is zero.
    """

    data: Tensor
    valid: Tensor
    sensor: Window
    region: Window
    tv: float
    isotropic: bool
    l1: float
    measured: Tensor
    rows: Tensor
    columns: Tensor
    scene: Tensor

    def estimate(self, penalty: float) -> Tensor:
        """Scene w = prox(a) of the last split: non-negative and zero outside the region."""
        top, left, height, width = self.region
        out = torch.zeros_like(self.scene)
        inside = self.scene[top : top + height, left : left + width]
        out[top : top + height, left : left + width] = (inside - self.l1 / penalty).clamp_min(0)
        return out


@dataclass(frozen=True)
class PassSums:
    """Sums over all cells that `update_splits_` gathers, each a tuple (x, u, w) by split.

    `primal` is Σ(Kv - x)², `split` Σx², `change` Σ(x - x_before)² and `multiplier_change`
    Σ(d - d_before)²; `misfit` is Σ(b - CMv)² over the
    valid pixels, `variation` ‖Ψv‖₁ and `magnitude` ‖v‖₁.
    """

    primal: tuple[float, float, float]
    split: tuple[float, float, float]
    change: tuple[float, float, float]
    multiplier_change: tuple[float, float, float]
    misfit: float
    variation: float
    magnitude: float


def solve_normal_equation_(
    spectrum: Tensor, transfer: Tensor, penalties: tuple[float, float, float]
) -> Tensor:
    r"""Solve (μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq_x + r at every frequency, in place.

    Parameters
    ----------
    spectrum
        Full spectrum of q_x + i r, (height, width) of the period, complex64; replaced by the
        spectrum of v + i Mv.
    transfer
        Half spectrum of the PSF, (height, width // 2 + 1).
    penalties
        μ₁, μ₂, μ₃.
    """
    if spectrum.device.type == "cpu":
        return solve_numba.solve_normal_equation_(spectrum, transfer, penalties)
    return admm_torch.solve_normal_equation_(spectrum, transfer, penalties)


def update_splits_(
    pair: Tensor,
    state: SplitState,
    penalties: tuple[float, float, float],
    next_penalties: tuple[float, float, float],
    relaxation: float,
) -> tuple[Tensor, PassSums]:
    """Update every split from (v, Mv), and prepare (q_x, r) of the next iteration, in place.

    Parameters
    ----------
    pair
        v + i Mv over the period; replaced by q_x + i r.
    state
        Arrays of this channel, updated.
    penalties
        Those with which v was computed.
    next_penalties
        Those of the next iteration; the multipliers are rescaled so that μd is unchanged.
    relaxation
        α in (0, 2); 1 is plain ADMM.
    """
    implementation = admm_numba if pair.device.type == "cpu" else admm_torch
    pair, sums = implementation.update_splits_(
        pair,
        (state.data, state.valid),
        (state.measured, state.rows, state.columns, state.scene),
        (state.sensor, state.region),
        (state.tv, state.isotropic, state.l1),
        (penalties, next_penalties, relaxation),
    )
    primal, split, change, multiplier_change = (
        (sums[k], sums[k + 1], sums[k + 2]) for k in range(0, 12, 3)
    )
    return pair, PassSums(
        primal=primal,
        split=split,
        change=change,
        multiplier_change=multiplier_change,
        misfit=sums[12],
        variation=sums[13],
        magnitude=sums[14],
    )
