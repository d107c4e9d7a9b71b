"""What depths, bands and frames of a video have in common: a stack of scenes is solved."""

from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.run import Run
from nolens.machine import BYTES_OF_PROGRAM, memory_bytes
from nolens.solvers import Progress, Result, StackProblem


@dataclass(frozen=True)
class SolvedStack:
    """A stack of scenes, and what the record has of it.

    Parameters
    ----------
    scene
        (channels, slices, height, width) of the support, or of the sensor's frame without one.
    result
        Of the solver.
    figures, parameters
        Of the run's product.
    """

    scene: Tensor
    result: Result
    figures: dict[str, Any]
    parameters: dict[str, Any]


def fewer_slices(
    what: str, asked: int, bytes_of_each: float, device: torch.device, remedy: str
) -> str:
    """What would need less memory, as the end of a sentence: how many slices would fit, and more.

    Parameters
    ----------
    what
        Slices of the stack, such as "depths".
    asked
        How many there are to be.
    bytes_of_each
        That one takes (`nolens.solvers.stack_bytes`).
    device
        Where it computes.
    remedy
        What else would need less.
    """
    fitting = int((memory_bytes(device) - BYTES_OF_PROGRAM) / bytes_of_each)
    if fitting >= asked:
        return remedy
    if fitting < 2:
        return f"not even 2 {what} would fit, so that fewer are no help; {remedy}"
    return f"{fitting} {what} would fit in place of {asked}; {remedy}"


def solve_stack(
    run: Run[ReconstructOptions],
    problem: StackProblem,
    what: str,
    *,
    iterations: int,
    tolerance: float,
    by_noise: bool = False,
) -> SolvedStack:
    """Solve a problem with the weight of the options, or one that is chosen.

    Parameters
    ----------
    run
        Its options, and who watches it.
    problem
        The problem.
    what
        The result, as a person who ends the run is told of it, such as "the volume".
    iterations, tolerance
        Where the options have none.
    by_noise
        Whether the noise, which is known, chooses the weight, and not held-out pixels.
    """
    options = run.options

    def watch_weight(fraction: float) -> bool:
        return run.reporter.step("% of the choice of tau", round(100 * fraction), 100, what)

    steps: list[dict[str, float]] = []
    if options.tau == "auto" and by_noise:
        tau = problem.weight_by_noise / options.detail
    elif options.tau == "auto":
        weight = problem.choose_weight(watch_weight)
        tau, steps = weight.tau / options.detail, [each.row() for each in weight.steps]
    else:
        tau = options.tau
    limit = options.iterations or iterations

    def watch(progress: Progress) -> bool:
        return run.reporter.progress(progress, limit)

    result = problem.solve(
        tau,
        iterations=limit,
        tolerance=tolerance if options.tolerance is None else options.tolerance,
        callback=watch,
    )
    forward, scene = problem.forward, result.scene.cpu()
    if forward.support is None:
        origin, (height, width) = forward.geometry.origin, forward.sensor
        scene = scene[..., -origin[0] : height - origin[0], -origin[1] : width - origin[1]]
    figures = {
        "method": "admm",
        "iterations": result.iterations,
        "stop_reason": "interrupted" if result.stop_reason == "callback" else result.stop_reason,
        "objective": result.objective,
        "tau": tau,
        "automatic_tau": options.tau == "auto",
    }
    support = "full" if forward.support is None else forward.support.text
    return SolvedStack(scene, result, figures, {"support": support, "weights": steps})
