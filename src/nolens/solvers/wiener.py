"""Tikhonov-regularised inverse in one shot (Wiener filter with white scene and noise)."""

import torch

from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result


def wiener(problem: Problem) -> Result:
    r"""Minimise ½‖Cᵀb − Mv‖² + τ/2 ‖v‖² over the period, then clip to v ≥ 0 and the region.

    v = F⁻¹[ conj(H) F(Cᵀb) / (|H|² + τ) ], with the measurement zero beside the sensor and at
    pixels that are not valid (`wiener1949`). As the PSF has unit norm, |H|² is 1 on average.
    The problem's prior is not used.

    Raises
    ------
    DataError
        If `tau` is zero: where the PSF passes nothing the filter would divide by zero.
    """
    if problem.tau == 0:
        raise DataError("tau is 0, and the Wiener filter then divides by zero; 0.01 to 1 is common")
    geometry = problem.forward.geometry
    top, left, height, width = geometry.sensor
    data = problem.data.new_zeros((problem.channels, *geometry.period))
    data[:, top : top + height, left : left + width] = problem.data
    transfer = problem.forward.transfer
    spectrum = rfft2(data) * transfer.conj() / (transfer.abs().square() + problem.tau)
    top, left, height, width = geometry.scene
    scene = irfft2(spectrum, geometry.period)[:, top : top + height, left : left + width]
    scene = scene.clamp_min(0)
    if not bool(torch.isfinite(scene).all()):
        raise DataError("the Wiener filter gave NaN or infinity; give a larger tau")
    return Result(
        scene=problem.unscale(scene),
        objective=problem.objective(scene),
        iterations=1,
        stop_reason="one shot",
    )
