"""The Wiener filter: the scene that is most likely by squares alone."""

import math

import torch
from torch import Tensor

from nolens.camera.values import all_finite
from nolens.errors import DataError
from nolens.kernels import irfft2_window_, rfft2_window
from nolens.solvers.linear_step import LinearStep
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result

_STEPS, _STEPS_AFTER = 15, 6
"""Of conjugate gradients, from a dark scene, and from one that is near: what more of them bring is
less than what a prior other than squares does."""
_ROWS = 64
"""Rows of the spectrum that are processed while they are in the cache."""
_BYTES_PER_PIXEL, _BYTES_OF_STEP, _BYTES_OF_SLOW = 9, 33, 42
"""Held per pixel of the padded shape: transfers and scene; of one channel, what its linear step
has; and per pixel of that channel's measurement, the images of slow cosines."""


def wiener_bytes(pixels: float, channels: int, values: int) -> float:
    """Most memory that the filter holds at once.

    Parameters
    ----------
    pixels
        `Problem.padded_pixels`.
    channels, values
        Of the measurement.
    """
    one = _BYTES_OF_STEP * pixels + _BYTES_OF_SLOW * values
    return _BYTES_PER_PIXEL * pixels + one / channels


def squares_unit(problem: Problem) -> float:
    """`Problem.tau_unit` where squares of differences are weighed in place of their magnitudes.

    Of b×b times fewer pixels each difference of a normalised scene is b³ times as large, and their
    squares together b⁴ times.

    Parameters
    ----------
    problem
        Whose unit is that of total variation.
    """
    return problem.tau_unit**2 * problem.data[0].numel() / 1e6


class LinearEstimate:
    r"""Goes nearer to the scene of smallest squares, each time from the scene before.

    .. math:: v = \arg\min_v \tfrac12 ‖V(b − CMv)‖^2 + \tfrac{τ}{2} ‖Ψv‖^2

    with V what counts of an image. It is Wiener's filter (`wiener1949`) for scenes whose power
    falls as 1/f², as that of photographs does, and white noise, of the pixels that were measured.

    Parameters
    ----------
    problem
        In normalised units; its prior and weight do not matter.
    start
        A scene that is near, in normalised units; None for a dark one.
    """

    def __init__(self, problem: Problem, start: Tensor | None = None) -> None:
        self._dark = problem.data.new_zeros((1, *problem.scene_shape[1:]))
        self._count = _STEPS if start is None else _STEPS_AFTER
        self._steps = [
            LinearStep(
                problem.single(channel),
                self._dark if start is None else start[channel : channel + 1],
                varied=True,
            )
            for channel in range(problem.channels)
        ]

    def solve(self, tau: float) -> None:
        """Go nearer to the scene of a weight."""
        for step in self._steps:
            step.solve(self._dark, (0.0, tau, 0.0), self._count)
        self._count = _STEPS_AFTER

    @property
    def scene(self) -> Tensor:
        """The scene so far, in normalised units; parts of it may be negative."""
        return torch.cat([step.v for step in self._steps])

    def objective(self, tau: float) -> float:
        """What is minimised, of the scene so far, mean over channels."""
        values = [step.objective((0.0, tau, 0.0)) for step in self._steps]
        return sum(values) / len(values)


def wiener(problem: Problem, start: Tensor | None = None) -> Result:
    r"""The scene of smallest squares (`LinearEstimate`), clipped to v ≥ 0.

    Fifteen steps of conjugate gradients from a dark scene, six from one that is near. The
    problem's prior is not used, and the objective of the result is that of this problem, before the
    clipping.

    Parameters
    ----------
    problem
        In normalised units.
    start
        A scene that is near, in normalised units; None for a dark one.

    Raises
    ------
    DataError
        If `tau` is zero: nothing then limits what the PSF does not pass.
    """
    _check_weight(problem)
    scenes, objective = [], 0.0
    for channel in range(problem.channels):  # One after the other: it is a matter of memory.
        own = None if start is None else start[channel : channel + 1]
        estimate = LinearEstimate(problem.single(channel), own)
        estimate.solve(problem.tau)
        scenes.append(estimate.scene.clamp_min_(0))
        objective += estimate.objective(problem.tau)
    return _result(problem, torch.cat(scenes), objective)


def circulant_wiener(problem: Problem) -> Result:
    r"""Minimise ½‖Cᵀb − Mv‖² + τ/2 ‖v‖² over the padded shape, then clip to v ≥ 0 and the support.

    v = F⁻¹[ conj(H) F(Cᵀb) / (|H|² + τ) ], with the measurement zero beside the sensor and at
    pixels that are not valid. Quicker than `wiener`, for frames that follow each other, and worse
    where much light falls on the sensor's edges. As the PSF has unit norm, |H|² is 1 on average.
    The problem's prior is not used, and the objective of the result is that of this problem,
    before the clipping: τ/2 Σ |F(Cᵀb)|² / (|H|² + τ) over the frequencies, over their number.

    Raises
    ------
    DataError
        If `tau` is zero: where the PSF passes nothing the filter would divide by zero.
    """
    _check_weight(problem)
    scene = problem.data.new_empty(problem.scene_shape)
    spectrum = torch.empty_like(problem.transfer(0))
    objectives = [
        _solve_channel(problem, channel, spectrum, out) for channel, out in enumerate(scene)
    ]
    return _result(problem, scene, sum(objectives))


def _check_weight(problem: Problem) -> None:
    if problem.tau == 0:
        raise DataError(
            "tau is 0, and the Wiener filter then has no limit on what the PSF does not pass; give "
            "a larger one, or none to have it chosen"
        )


def _result(problem: Problem, scene: Tensor, objective: float) -> Result:
    """Of a normalised scene, and the sum of its channels' objectives."""
    if not all_finite(scene):
        raise DataError("the Wiener filter gave NaN or infinity; give a larger tau")
    return Result(
        scene=scene.mul_(problem.scale),
        objective=objective / problem.channels,
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
