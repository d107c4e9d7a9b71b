"""What quality `photo` of `nolens reconstruct` does, for those parts of the benchmark in Python."""

from __future__ import annotations

from nolens.solvers import Problem, Result, admm


def photo(problem: Problem) -> Result:
    """Solve as `--quality photo` does."""
    return admm(problem, iterations=40, tolerance=0.0)
