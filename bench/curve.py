"""Objective against seconds for a solver that is watched from outside."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy.typing as npt

from objective import Objective


def sample(iteration: int, every: int) -> bool:
    """Whether an iteration is looked at: all of the first `every`, then steps of 3 to 6 %."""
    if iteration <= every:
        return True
    return iteration % max(1, 2 ** (iteration.bit_length() - 5)) == 0


class Trace:
    """Seconds and objective by iteration; the clock stops while the objective is computed."""

    def __init__(self, objective: Objective, iterations: int, every: int = 60) -> None:
        self.objective = objective
        self.rows: list[tuple[int, float, float]] = []
        self._last = iterations
        self._every = every
        self._paused = 0.0
        self._start = perf_counter()

    def watch(self, iteration: int, iterate: Callable[[], npt.ArrayLike]) -> None:
        """Call after each iteration; `iterate` gives the scene on its whole domain when asked."""
        now = perf_counter()
        if iteration == self._last or sample(iteration, self._every):
            value = self.objective(iterate())
            self.rows.append((iteration, now - self._start - self._paused, value))
        self._paused += perf_counter() - now
