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

import functools
import importlib.util
import warnings
from dataclasses import dataclass
from types import ModuleType

import torch
from torch import Tensor

from nolens.kernels import admm_torch

Triple = tuple[float, float, float]

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
        """Scene w = prox(a) of the last split on the region's cells: non-negative."""
        top, left, height, width = self.region
        inside = self.scene[top : top + height, left : left + width]
        return (inside - self.l1 / penalty).clamp_min_(0)

    def rescale_(self, penalties: Triple, following: Triple) -> None:
        """Write the state for other penalties: the splits and the multipliers μd are kept."""
        still = torch.zeros_like(self.scene, dtype=torch.complex64)
        update_splits_(still, self, penalties, following, 0.0, counted=False)


@dataclass(frozen=True)
class PassSums:
    """Sums over all cells that `update_splits_` gathers, each a tuple (x, u, w) by split.

    `primal` is Σ(Kv - x)², `split` Σx², `change` Σ(x - x_before)² and `multiplier_change`
    Σ(d - d_before)²; `misfit` is Σ(b - CMv)² over the
    valid pixels, `variation` ‖Ψv‖₁ and `magnitude` ‖v‖₁.
    """

    primal: Triple
    split: Triple
    change: Triple
    multiplier_change: Triple
    misfit: float
    variation: float
    magnitude: float

    @classmethod
    def of(cls, sums: list[float]) -> "PassSums":
        """Sums in the order of the passes: four of (x, u, w), then the last three."""
        primal, split, change, multiplier_change = (
            (sums[k], sums[k + 1], sums[k + 2]) for k in range(0, 12, 3)
        )
        return cls(primal, split, change, multiplier_change, *sums[12:])


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
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
        on_cpu = importlib.import_module("nolens.kernels.solve_numba")
        result: Tensor = on_cpu.solve_normal_equation_(spectrum, transfer, penalties)
        return result
    constants = _on_device([*penalties], spectrum.device)
    solved: Tensor = device_passes(spectrum).solve_normal_equation_(spectrum, transfer, constants)
    return solved


def update_splits_(
    pair: Tensor,
    state: SplitState,
    penalties: Triple,
    next_penalties: Triple,
    relaxation: float,
    *,
    counted: bool = True,
) -> tuple[Tensor, PassSums | None]:
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
    counted
        Whether the sums are wanted: they are a third of the work, and on CUDA the wait for them.
    """
    prior = (state.tv, state.isotropic, state.l1)
    step = (penalties, next_penalties, relaxation)
    if pair.device.type == "cpu":
        pair, sums = importlib.import_module("nolens.kernels.admm_numba").update_splits_(
            pair,
            (state.data, state.valid),
            (state.measured, state.rows, state.columns, state.scene),
            (state.sensor, state.region),
            prior,
            step,
            counted=counted,
        )
    else:
        constants = _on_device(admm_torch.step_constants(prior, step), pair.device)
        sums = update_on_device_(pair, state, constants, counted=counted, out=pair)
    return pair, None if sums is None else PassSums.of(sums)


def update_on_device_(
    pair: Tensor, state: SplitState, constants: Tensor, *, counted: bool, out: Tensor
) -> list[float] | None:
    """`update_splits_` by `device_passes`.

    Parameters
    ----------
    pair
        v + i Mv over the period.
    state
        Arrays of this channel, updated.
    constants
        `admm_torch.step_constants`, float32, on the pair's device.
    counted
        Whether the sums are wanted.
    out
        Where q_x + i r goes; `pair` itself may be.
    """
    sums: list[float] | None = device_passes(pair).update_splits_(
        pair,
        (state.data, state.valid),
        (state.measured, state.rows, state.columns, state.scene),
        (state.sensor, state.region),
        (state.tv > 0, state.isotropic),
        constants,
        counted=counted,
        out=out,
    )
    return sums


def device_passes(field: Tensor) -> ModuleType:
    """Passes with constants on the field's device: Triton's where it runs, else torch's."""
    # Triton's offsets are 32 bits wide, and a complex cell is two numbers.
    if field.device.type == "cuda" and field.numel() < 2**30 and _triton_runs(field.device):
        return importlib.import_module("nolens.kernels.admm_triton")
    return admm_torch


def _on_device(constants: list[float], device: torch.device) -> Tensor:
    """Constants on their way to the device, without waiting for what it still computes."""
    return torch.tensor(constants, dtype=torch.float32).to(device, non_blocking=True)


@functools.cache
def _triton_runs(device: torch.device) -> bool:
    """Whether Triton is installed and can compile for the device; it needs a C compiler too."""
    if importlib.util.find_spec("triton") is None:
        return False
    field = torch.zeros(1, 1, dtype=torch.complex64, device=device)
    try:
        passes = importlib.import_module("nolens.kernels.admm_triton")
        passes.solve_normal_equation_(field, field.clone(), torch.ones(3, device=device))
    except Exception as error:
        warnings.warn(f"Triton does not run here, torch's passes do: {error}", stacklevel=2)
        return False
    return True
