"""Accelerated proximal gradient for eq. 7, for comparison with ADMM."""

from collections.abc import Iterator
from dataclasses import replace

from torch import Tensor

from nolens.solvers.objective import solve
from nolens.solvers.problem import Problem
from nolens.solvers.proximal_gradient import ProximalGradientRun
from nolens.solvers.result import Callback, Progress, Result

_BYTES_PER_PIXEL = 170
"""Held in the proximal map of the total variation, per pixel of the padded shape."""


def fista_bytes(pixels: float) -> float:
    """Most memory that a run holds at once, for so many `Problem.padded_pixels`."""
    return pixels * _BYTES_PER_PIXEL


def fista(
    problem: Problem,
    *,
    iterations: int = 200,
    tolerance: float = 1e-4,
    start: Tensor | None = None,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise ½‖b − CMv‖² + τ R(v), v ≥ 0, by FISTA (`beck2009`).

    `proximal_gradient` of the problem's functionals, with L = ‖CM‖² or a little more, and without
    restarts, so that channels do not hang on each other.

    Parameters
    ----------
    problem
        In normalised units.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when ‖v − v_before‖ ≤ tolerance · ‖v‖. 0 runs to the limit.
    start
        Scene in normalised units, (channels, height, width); None for a dark one, from which what
        the PSF hardly carries takes thousands of iterations.
    callback
        Called after every iteration; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    data, *others = problem.functionals
    run = ProximalGradientRun(
        [data.parts],
        others,
        problem.data.new_zeros(problem.scene_shape) if start is None else start,
        problem.forward.norm_bound**2,
        restart=False,
        backtracking=False,
    )

    def means() -> Iterator[Progress]:
        for step in run.steps(iterations):
            yield replace(step, objective=step.objective / problem.channels)

    result = solve(
        means(), problem.objective, iterations=iterations, tolerance=tolerance, callback=callback
    )
    return replace(result, scene=problem.unscale(result.scene), frame=problem.frame)
