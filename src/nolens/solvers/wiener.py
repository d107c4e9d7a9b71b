"""Tikhonov-regularised inverse in one shot (Wiener filter with white scene and noise)."""

import math

import torch
from torch import Tensor

from nolens.camera.values import all_finite
from nolens.errors import DataError
from nolens.kernels import irfft2_window_, rfft2_window
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result

_ROWS = 64
"""Rows of the spectrum that are processed while they are in the cache."""
_BYTES_PER_PIXEL = 14
"""Held per pixel of the padded shape: the spectra, and the scene."""


def wiener_bytes(pixels: float) -> float:
    """Most memory that the filter holds at once, for so many `Problem.padded_pixels`."""
    return pixels * _BYTES_PER_PIXEL


def wiener(problem: Problem) -> Result:
    r"""Minimise ½‖Cᵀb − Mv‖² + τ/2 ‖v‖² over the padded shape, then clip to v ≥ 0 and the support.

    v = F⁻¹[ conj(H) F(Cᵀb) / (|H|² + τ) ], with the measurement zero beside the sensor and at
    pixels that are not valid (`wiener1949`). As the PSF has unit norm, |H|² is 1 on average.
    The problem's prior is not used, and the objective of the result is that of this problem,
    before the clipping: τ/2 Σ |F(Cᵀb)|² / (|H|² + τ) over the frequencies, over their number.

    Raises
    ------
    DataError
        If `tau` is zero: where the PSF passes nothing the filter would divide by zero.
    """
    if problem.tau == 0:
        raise DataError("tau is 0, and the Wiener filter then divides by zero; 0.01 to 1 is common")
    scene = problem.data.new_empty(problem.scene_shape)
    spectrum = torch.empty_like(problem.transfer(0))
    objectives = [
        _solve_channel(problem, channel, spectrum, out) for channel, out in enumerate(scene)
    ]
    if not all_finite(scene):
        raise DataError("the Wiener filter gave NaN or infinity; give a larger tau")
    return Result(
        scene=scene.mul_(problem.scale),
        objective=sum(objectives) / problem.channels,
        iterations=1,
        stop_reason="one shot",
        frame=problem.frame,
    )


def _solve_channel(problem: Problem, channel: int, spectrum: Tensor, out: Tensor) -> float:
    """Put a channel's normalised scene into `out`; its objective. `spectrum` is memory."""
    geometry, data = problem.forward.geometry, problem.data[channel]
    rfft2_window(data, geometry.sensor[:2], geometry.padded, spectrum)
    # Half spectra leave out the mirrors of all columns but the first and an even width's last.
    twice = torch.full((spectrum.shape[1],), 2.0, dtype=torch.float64, device=data.device)
    twice[[0, -1] if geometry.padded[1] % 2 == 0 else [0]] = 1.0
    power = torch.zeros_like(twice)
    both = (torch.split(each, _ROWS) for each in (spectrum, problem.transfer(channel)))
    for part, transfer in zip(*both, strict=True):
        inverse = _power(transfer).add_(problem.tau).reciprocal_()
        power += (_power(part) * inverse).sum(dim=0, dtype=torch.float64)
        part *= transfer.conj() * inverse
    objective = problem.tau / 2 * float((power * twice).sum()) / math.prod(geometry.padded)
    scene = irfft2_window_(spectrum, geometry.scene, geometry.padded)
    torch.clamp_min(scene, 0, out=out)
    return objective


def _power(field: Tensor) -> Tensor:
    """|z|² of a complex field."""
    return field.real.square().addcmul_(field.imag, field.imag)
