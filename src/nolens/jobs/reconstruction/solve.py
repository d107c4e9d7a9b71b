"""Which solver does what was asked for, when it stops, and what it will need."""

import math

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.jobs.cost import Cost, duration_text
from nolens.jobs.reconstruction.options import ReconstructOptions
from nolens.jobs.reporter import Reporter
from nolens.operators import Region
from nolens.solvers import Method, Problem, Quality, Reconstructor, stop_of
from nolens.solvers.penalties import Balance

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


def reconstructor_of(
    options: ReconstructOptions, psf: Tensor, region: Region | None, device: torch.device
) -> Reconstructor:
    """What solves: the preset's limits, with what was given in their place.

    Parameters
    ----------
    options
        What was asked for.
    psf, region
        That fit the measurement.
    device
        Where to compute.
    """
    method = method_of(options)
    return Reconstructor(
        psf,
        region,
        tau=options.tau,
        prior=options.prior,
        method=method,
        stop=stop_of(
            method,
            options.quality,
            iterations=options.iterations,
            tolerance=options.tolerance,
            smooth_part=options.smooth_part,
        ),
        penalties=options.penalties,
        balance=Balance() if options.balance else None,
        relaxation=options.relaxation,
        device=device,
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
