"""How the benchmark solves: quality `photo` of `nolens reconstruct`, and the quickest full view."""

from __future__ import annotations

from dataclasses import replace

from nolens.solvers import STOPS, Problem, Quality, Result, admm

QUICK = 24
"""Iterations after which a full view is near its end."""


def photo(problem: Problem, *, low_frequency: bool | None = None) -> Result:
    """Solve as `--quality photo` does, or with --low-frequency or --no-low-frequency."""
    stop = STOPS[Quality.PHOTO]
    if low_frequency is not None:
        stop = replace(stop, low_frequency=low_frequency)
    return admm(
        problem,
        iterations=stop.iterations,
        tolerance=stop.tolerance,
        scene_tolerance=stop.scene_tolerance,
        low_frequency=stop.low_frequency,
    )


def quick(problem: Problem) -> Result:
    """Solve as `--low-frequency --iterations 24 --tolerance 0` does."""
    return admm(problem, iterations=QUICK, tolerance=0.0, low_frequency=True)
