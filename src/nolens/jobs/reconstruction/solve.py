"""Which solver does what was asked for, when it stops, and what it will need."""

import math
from dataclasses import replace

import torch

from nolens.errors import OptionError
from nolens.jobs.cost import Cost, duration_text
from nolens.jobs.reconstruction.options import Method, ReconstructOptions
from nolens.jobs.reporter import Reporter
from nolens.solvers import STOPS, AdmmState, Problem, Quality, Result, Stop, admm, fista, wiener
from nolens.solvers.penalties import Balance
from nolens.solvers.result import Callback

_TAU = {Method.ADMM: 1e-4, Method.FISTA: 1e-4, Method.WIENER: 0.1}
_OTHERS = {
    Method.FISTA: Stop(300, tolerance=1e-4, scene_tolerance=0.0, smooth_part=False),
    Method.WIENER: Stop(1, tolerance=0.0, scene_tolerance=0.0, smooth_part=False),
}

_SPARE = 4

# Per cell of the period and channel, as `make bench` saw them on two cores: the most memory that a
# run holds (in its first and last step), and what one iteration takes.
_BYTES_PER_CELL = 60
_SECONDS_PER_CELL = 1.5e-8


def method_of(options: ReconstructOptions) -> Method:
    """The solver: what --quality or --method say.

    Raises
    ------
    OptionError
        If they contradict each other.
    """
    if options.quality is None:
        return options.method
    if options.method is not Method.ADMM:
        raise OptionError(
            f"--quality {options.quality} chooses how to solve, and so does --method "
            f"{options.method}: leave one out"
        )
    return Method.WIENER if options.quality is Quality.DRAFT else Method.ADMM


def spare_of(options: ReconstructOptions) -> int:
    """How many times finer than what the PSF carries the cells of the scene are worth to be.

    What is assumed of a scene finds edges between what the PSF carries; Wiener's filter does not.
    """
    return 1 if method_of(options) is Method.WIENER else _SPARE


def tau_of(options: ReconstructOptions) -> float:
    """Weight of the prior."""
    return _TAU[method_of(options)] if options.tau is None else options.tau


def stop_of(options: ReconstructOptions) -> Stop:
    """When to stop: the preset's, with what was given in its place."""
    method = method_of(options)
    if method is not Method.ADMM:
        stop = _OTHERS[method]
    else:
        stop = STOPS[Quality.PHOTO if options.quality is None else options.quality]
    if options.tolerance is not None:
        stop = replace(stop, tolerance=options.tolerance, scene_tolerance=0.0)
    if options.iterations is not None:
        stop = replace(stop, iterations=options.iterations)
    if options.smooth_part is not None:
        stop = replace(stop, smooth_part=options.smooth_part)
    return stop


def solve(
    problem: Problem, options: ReconstructOptions, state: AdmmState | None, callback: Callback
) -> Result:
    """Solve as the options say; `state` is ADMM's to start from."""
    method, stop = method_of(options), stop_of(options)
    if method is Method.WIENER:
        return wiener(problem)
    if method is Method.FISTA:
        return fista(
            problem, iterations=stop.iterations, tolerance=stop.tolerance, callback=callback
        )
    return admm(
        problem,
        iterations=stop.iterations,
        tolerance=stop.tolerance,
        scene_tolerance=stop.scene_tolerance,
        smooth_part=stop.smooth_part,
        penalties=options.penalties,
        balance=Balance() if options.balance else None,
        relaxation=options.relaxation,
        state=state,
        callback=callback,
    )


def solving_cost(problem: Problem, iterations: float) -> Cost:
    """What ADMM needs for a problem, as `make bench` saw it on two cores."""
    cells = math.prod(problem.forward.geometry.period) * problem.channels
    return Cost(cells * _BYTES_PER_CELL, cells * iterations * _SECONDS_PER_CELL)


def announce_solving(
    problem: Problem, limit: int, device: torch.device, reporter: Reporter
) -> None:
    """Say beforehand what will take minutes or gigabytes.

    Parameters
    ----------
    problem
        To be solved.
    limit
        Iterations at most.
    device
        Where; seconds are known for the CPU.
    reporter
        Is told.
    """
    height, width = problem.forward.geometry.period
    cost = solving_cost(problem, limit)
    gigabytes, seconds = cost.bytes / 1e9, cost.seconds
    if gigabytes > 1 or (seconds > 60 and device.type == "cpu"):
        reporter.note(
            f"{problem.channels} × {height}×{width} cells: about {gigabytes:.1f} GB of memory"
            + (f" and {duration_text(seconds)} on two cores" if device.type == "cpu" else "")
            + f" for {limit} iterations at most"
        )
