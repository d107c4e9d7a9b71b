"""Cases for the passes of ADMM: sizes, windows, masks, priors, and penalties that change."""

from dataclasses import dataclass, replace
from types import ModuleType

import numpy as np
import torch

from nolens.kernels import SplitState
from nolens.kernels.admm import step_constants

Triple = tuple[float, float, float]
Window = tuple[int, int, int, int]
MU: Triple = (0.3, 2.0, 0.7)
LATER: Triple = (0.5, 1.5, 0.9)


@dataclass(frozen=True)
class Case:
    size: tuple[int, int] = (12, 10)
    sensor: Window = (3, 2, 6, 5)
    support: Window = (0, 0, 12, 10)
    tv: float = 0.4
    isotropic: bool = False
    l1: float = 0.0
    masked: float = 0.2
    later: Triple = MU
    relaxation: float = 1.0


BASE = Case()
CASES = {
    "even": BASE,
    "odd": replace(BASE, size=(9, 7), sensor=(2, 1, 5, 5), support=(0, 0, 9, 7)),
    "more rows than blocks": replace(
        BASE, size=(75, 6), sensor=(31, 0, 33, 4), support=(0, 0, 75, 6)
    ),
    "as many rows as blocks": replace(
        BASE, size=(32, 5), sensor=(0, 0, 32, 5), support=(0, 0, 32, 5)
    ),
    "one row": replace(BASE, size=(1, 8), sensor=(0, 2, 1, 3), support=(0, 1, 1, 6)),
    "two rows": replace(BASE, size=(2, 3), sensor=(0, 0, 1, 2), support=(0, 0, 2, 3)),
    "more cells than a program": replace(
        BASE, size=(40, 31), sensor=(3, 2, 33, 24), support=(1, 4, 36, 26), relaxation=1.8
    ),
    "more cells than a program, isotropic": replace(
        BASE, size=(41, 30), sensor=(3, 2, 33, 24), support=(0, 0, 41, 30), isotropic=True
    ),
    "support": replace(BASE, support=(4, 3, 5, 6)),
    "support beside the sensor": replace(BASE, sensor=(0, 0, 6, 5), support=(7, 6, 5, 4)),
    "sensor at the far corner": replace(BASE, sensor=(6, 5, 6, 5), support=(0, 0, 3, 4)),
    "all valid": replace(BASE, masked=0.0),
    "none valid": replace(BASE, masked=1.0),
    "isotropic": replace(BASE, isotropic=True, support=(4, 3, 5, 6)),
    "isotropic, odd": replace(BASE, isotropic=True, size=(35, 7), support=(0, 0, 35, 7)),
    "l1": replace(BASE, tv=0.0, l1=0.3),
    "no prior": replace(BASE, tv=0.0),
    "relaxed": replace(BASE, relaxation=1.8),
    "under-relaxed": replace(BASE, relaxation=0.6, isotropic=True),
    "still": replace(BASE, relaxation=0.0),
    "penalties change": replace(BASE, later=LATER),
    "penalties change, isotropic": replace(BASE, later=LATER, isotropic=True, relaxation=1.5),
    "penalties change, l1": replace(BASE, later=LATER, tv=0.0, l1=0.3, relaxation=1.5),
}


def draw(case: Case, device: str = "cpu") -> tuple[torch.Tensor, SplitState]:
    generator = torch.Generator().manual_seed(11)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=generator).to(device)

    of_tv = case.size if case.tv > 0 else (0, 0)
    valid = torch.rand(case.sensor[2:], generator=generator) >= case.masked
    state = SplitState(
        data=normal(*case.sensor[2:]),
        valid=valid.to(device, torch.uint8),
        sensor=case.sensor,
        support=case.support,
        tv=case.tv,
        isotropic=case.isotropic,
        l1=case.l1,
        measured=normal(*case.size),
        rows=normal(*of_tv),
        columns=normal(*of_tv),
        scene=normal(*case.size),
    )
    return torch.complex(normal(*case.size), normal(*case.size)), state


def arrays(state: SplitState) -> tuple[torch.Tensor, ...]:
    return (state.measured, state.rows, state.columns, state.scene)


def update(
    module: ModuleType,
    case: Case,
    pair: torch.Tensor,
    state: SplitState,
    *,
    counted: bool = True,
) -> tuple[torch.Tensor, list[float] | None]:
    """The update by one module, of any device."""
    constants = torch.tensor(
        step_constants(state, MU, case.later, case.relaxation), device=pair.device
    )
    sums = module.update_splits_(pair, state, constants, counted=counted, out=pair)
    return pair, sums


def normal_equation(
    size: tuple[int, int], penalties: Triple
) -> tuple[torch.Tensor, torch.Tensor, np.ndarray]:
    """q + ir and M of a draw, and v + iMv of (μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq + r; spectra."""
    rng = np.random.default_rng(2)
    kernel, q, r = rng.normal(size=(3, *size))
    h = np.fft.fft2(kernel)
    rows = 2 - 2 * np.cos(2 * np.pi * np.arange(size[0]) / size[0])
    columns = 2 - 2 * np.cos(2 * np.pi * np.arange(size[1]) / size[1])
    mu_x, mu_u, mu_w = penalties
    normal = mu_x * np.abs(h) ** 2 + mu_u * (rows[:, None] + columns) + mu_w
    v = (mu_x * h.conj() * np.fft.fft2(q) + np.fft.fft2(r)) / normal
    spectrum = torch.from_numpy(np.fft.fft2(q + 1j * r).astype(np.complex64))
    transfer = torch.from_numpy(np.fft.rfft2(kernel).astype(np.complex64))
    return spectrum, transfer, v + 1j * h * v
