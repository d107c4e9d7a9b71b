"""Tikhonov-regularised inverse in one shot (Wiener filter with white scene and noise)."""

import torch
from torch import Tensor

from nolens.camera.finite import all_finite
from nolens.errors import DataError
from nolens.kernels import fft2_, ifft2_, in_large_pages, solve_normal_equation_
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result


def wiener(problem: Problem) -> Result:
    r"""Minimise ½‖Cᵀb − Mv‖² + τ/2 ‖v‖² over the period, then clip to v ≥ 0 and the region.

    v = F⁻¹[ conj(H) F(Cᵀb) / (|H|² + τ) ], with the measurement zero beside the sensor and at
    pixels that are not valid (`wiener1949`). As the PSF has unit norm, |H|² is 1 on average.
    The problem's prior is not used, and the objective of the result is that of this problem,
    before the clipping. It is ADMM's normal equation with the penalties (1, 0, τ).

    Raises
    ------
    DataError
        If `tau` is zero: where the PSF passes nothing the filter would divide by zero.
    """
    if problem.tau == 0:
        raise DataError("tau is 0, and the Wiener filter then divides by zero; 0.01 to 1 is common")
    period, device = problem.forward.geometry.period, problem.data.device
    field = in_large_pages(torch.zeros(period, dtype=torch.complex64, device=device))
    solved = [_channel(problem, channel, field) for channel in range(problem.channels)]
    scene = torch.stack([part for part, _ in solved])
    if not all_finite(scene):
        raise DataError("the Wiener filter gave NaN or infinity; give a larger tau")
    return Result(
        scene=problem.unscale(scene),
        objective=sum(objective for _, objective in solved) / problem.channels,
        iterations=1,
        stop_reason="one shot",
    )


def _channel(problem: Problem, channel: int, field: Tensor) -> tuple[Tensor, float]:
    """Scene of a channel, and its objective; `field`, of the period's size, is overwritten."""
    geometry, data = problem.forward.geometry, problem.data[channel]
    top, left, height, width = geometry.sensor
    field.zero_()
    sensor = field[top : top + height, left : left + width]
    sensor.real[...] = data
    spectrum = fft2_(field)
    solve_normal_equation_(spectrum, problem.transfer(channel), (1.0, 0.0, problem.tau))
    pair = torch.view_as_real(ifft2_(spectrum))
    energy = torch.linalg.vector_norm(pair, dim=(0, 1)).double().square()
    seen = pair[top : top + height, left : left + width, 1]
    # ‖Cᵀb − Mv‖² = ‖Mv‖² + Σ b (b − 2 Mv) over the sensor, as Cᵀb is zero beside it.
    misfit = energy[1] + (data * (data - 2 * seen)).sum(dtype=torch.float64)
    top, left, height, width = geometry.scene
    scene = pair[top : top + height, left : left + width, 0].clamp_min(0)
    return scene, float(misfit + problem.tau * energy[0]) / 2
