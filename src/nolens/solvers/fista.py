"""Accelerated proximal gradient for eq. 7, for comparison with ADMM."""

import math

import torch
from torch import Tensor

from nolens.errors import DivergenceError, OptionError
from nolens.operators import FiniteDifference
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result, StopReason

_INNER = 10
"""Steps of the dual iteration in each proximal map; warm-started, a few are enough."""
_BYTES_PER_PIXEL = 120
"""Held in the proximal map of the total variation, per pixel of the padded shape."""


def fista_bytes(pixels: float) -> float:
    """Most memory that a run holds at once, for so many `Problem.padded_pixels`."""
    return pixels * _BYTES_PER_PIXEL


def fista(
    problem: Problem,
    *,
    iterations: int = 200,
    tolerance: float = 1e-4,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise ½‖b − CMv‖² + τ R(v), v ≥ 0, by FISTA (`beck2009`).

    v ← prox(y − (1/L) M*C*(CMy − b)) with L = max|H|², the largest eigenvalue of M*M, and the
    momentum of Nesterov. The proximal map of the total variation under the constraints is
    solved in its dual (`beck2009tv`).

    Parameters
    ----------
    problem
        In normalised units.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when ‖v − v_before‖ ≤ tolerance · ‖v‖. 0 runs to the limit.
    callback
        Called after every iteration; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    if iterations < 1 or not tolerance >= 0:
        raise OptionError(
            f"iterations is {iterations} and tolerance {tolerance:g}; they must be at least 1 and 0"
        )
    forward = problem.forward
    lipschitz = float(forward.transfer.abs().max()) ** 2
    proximal = _Proximal(problem, problem.tau / lipschitz)
    v = problem.data.new_zeros(problem.scene_shape)
    y, momentum = v, 1.0
    history: list[dict[str, float]] = []
    stop_reason: StopReason = "iteration limit"
    for iteration in range(1, iterations + 1):
        residual = torch.where(problem.valid, forward(y) - problem.data, 0)
        before, v = v, proximal(y - forward.adjoint(residual) / lipschitz)
        following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
        y = v + (momentum - 1) / following * (v - before)
        momentum = following
        size = float(torch.linalg.vector_norm(v.double()))
        change = float(torch.linalg.vector_norm((v - before).double()))
        if not math.isfinite(size):
            raise DivergenceError(f"the iteration gave NaN or infinity at step {iteration}")
        relative = change / size if size > 0 else 0.0
        progress = Progress(
            iteration=iteration,
            objective=problem.objective(v),
            primal_residual=0.0,
            dual_residual=relative,
            scene_change=relative,
            penalties=(lipschitz,),
            scene=lambda v=v: v,  # type: ignore[misc]
        )
        history.append(progress.row())
        if callback is not None and callback(progress):
            stop_reason = "callback"
            break
        if iteration > 1 and relative <= tolerance:
            stop_reason = "converged"
            break
    return Result(
        scene=problem.unscale(v),
        objective=problem.objective(v),
        iterations=len(history),
        stop_reason=stop_reason,
        frame=problem.frame,
        history=history,
    )


class _Proximal:
    """argmin ½‖x − z‖² + weight·R(x) over x ≥ 0, on the scene's pixels, with a warm dual."""

    def __init__(self, problem: Problem, weight: float) -> None:
        self._problem = problem
        self._weight = weight
        self._difference = FiniteDifference(problem.forward.geometry.padded)
        self._dual: Tensor | None = None

    def __call__(self, z: Tensor) -> Tensor:
        prior = self._problem.prior
        if prior is Prior.L1:
            return (z - self._weight).clamp_min(0)
        if prior is Prior.NONE or self._weight == 0:
            return z.clamp_min(0)
        padded = self._problem.forward.embed(z)
        dual = self._dual if self._dual is not None else self._difference(padded) * 0
        ahead, momentum = dual, 1.0
        for _ in range(_INNER):
            # ‖Ψ‖² ≤ 8, so 1/8 is the step of the dual.
            ascent = self._difference(self._primal(padded, ahead)) / (8 * self._weight)
            before, dual = dual, self._into_ball(ahead + ascent)
            following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            ahead = dual + (momentum - 1) / following * (dual - before)
            momentum = following
        self._dual = dual
        top, left, height, width = self._problem.forward.geometry.scene
        return self._primal(padded, dual)[..., top : top + height, left : left + width]

    def _primal(self, padded: Tensor, dual: Tensor) -> Tensor:
        top, left, height, width = self._problem.forward.geometry.scene
        moved = padded - self._weight * self._difference.adjoint(dual)
        return self._problem.forward.embed(
            moved[..., top : top + height, left : left + width].clamp_min(0)
        )

    def _into_ball(self, dual: Tensor) -> Tensor:
        if self._problem.prior is Prior.ISOTROPIC_TV:
            length: Tensor = torch.linalg.vector_norm(dual, dim=-3, keepdim=True)
            return dual / length.clamp_min(1)
        return dual.clamp(-1, 1)
