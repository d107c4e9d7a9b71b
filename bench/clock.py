"""Progress on standard error, with the time left. Standard library only."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

# Weight of a second on two cores of 2026: one iteration of nolens over one value weighs 1.
PER_SECOND = 1.7e7
PAUSE = 0.3  # seconds between steps, for the threads of the last one to go to sleep


class Clock:
    """Progress lines with the time left.

    Parameters
    ----------
    total
        Weight of all steps together.
    """

    def __init__(self, total: float) -> None:
        self._total, self._done, self._start = total, 0.0, time.monotonic()
        print(f"about {spoken(total / PER_SECOND)} on two idle cores", file=sys.stderr)

    @contextmanager
    def step(self, label: str, weight: float) -> Iterator[None]:
        """Say what is done now, then how long it took and what is left."""
        print(f"{label} ...", end="", file=sys.stderr, flush=True)
        start = time.monotonic()
        yield
        now = time.monotonic()
        self._done += weight
        left = (now - self._start) * (self._total / self._done - 1)
        known = self._done > 0.05 * self._total
        ahead = f", about {spoken(left)} left" if known else ""
        print(f" {now - start:.1f} s{ahead}", file=sys.stderr, flush=True)
        time.sleep(PAUSE)


def spoken(seconds: float) -> str:
    """Seconds, or minutes where they are many."""
    return f"{seconds:.0f} s" if seconds < 90 else f"{seconds / 60:.0f} min"
