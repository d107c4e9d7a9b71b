"""Objective, and quality where there is a truth, against seconds for a solver watched outside."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from time import perf_counter

import numpy as np
import numpy.typing as npt

from objective import Objective
from quality import Quality

CLOSE = 60  # iterations that are all looked at where looks are cheap

Row = tuple[int, float, float, float | None]
"""iteration, seconds, objective, PSNR in dB where there is a truth"""


def looks(iterations: int, count: int | None) -> frozenset[int]:
    """Iterations to look at, the last one among them.

    Parameters
    ----------
    iterations
        How many there are.
    count
        How many looks, in geometric steps; None for all of the first 60 and then steps of 3 to
        6 %.
    """
    if count is None:
        return frozenset(n for n in range(1, iterations + 1) if close(n)) | {iterations}
    ratio = iterations ** (1 / max(1, count - 1))
    return frozenset(round(ratio**k) for k in range(count - 1)) | {iterations}


def close(iteration: int) -> bool:
    """Whether an iteration is looked at where looks are cheap."""
    return iteration <= CLOSE or iteration % max(1, 2 ** (iteration.bit_length() - 5)) == 0


def judges(files: Mapping[str, str], tau: float) -> tuple[Objective, Quality | None]:
    """What iterates are judged by, from the files of a case: psf, data and perhaps truth."""
    psf, data = np.load(files["psf"]), np.load(files["data"])
    truth = np.load(files["truth"]) if "truth" in files else None
    quality = None if truth is None else Quality(truth, data.shape[-2:])
    return Objective(psf, data, tau), quality


class Trace:
    """What is seen at some iterations; the clock, started here, stops while it is computed.

    Parameters
    ----------
    objective
        To judge iterates by.
    quality
        The same by their distance to the truth; None where that is not known.
    at
        Iterations to look at; where `watch` is not called for one of them, the next is looked at.
    """

    def __init__(self, objective: Objective, quality: Quality | None, at: frozenset[int]) -> None:
        self.rows: list[Row] = []
        self._objective, self._quality = objective, quality
        self._at = sorted(at)
        self._paused = 0.0
        self._start = perf_counter()

    def watch(self, iteration: int, iterate: Callable[[], npt.ArrayLike]) -> None:
        """Call after iterations; `iterate` gives the scene on its whole domain when asked."""
        with self.aside() as seconds:
            due = bisect_right(self._at, iteration)
            if due:
                del self._at[:due]
                scene = iterate()
                decibels = None if self._quality is None else self._quality(scene)
                self.rows.append((iteration, seconds, self._objective(scene), decibels))

    @contextmanager
    def aside(self) -> Iterator[float]:
        """Stop the clock, at the seconds so far, for what does not count."""
        now = perf_counter()
        yield now - self._start - self._paused
        self._paused += perf_counter() - now
