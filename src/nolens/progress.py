"""Callbacks that computations call with the fraction of their work that is done, and time."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import UTC, datetime

ProgressCallback = Callable[[float], None]
_RELIABLE_AFTER_S = 5.0


def part_of(progress: ProgressCallback | None, number: int, count: int) -> ProgressCallback:
    """Callback for one of several equal parts of the work; it does nothing where there is none.

    Parameters
    ----------
    progress
        Called with the fraction of all parts, 0 to 1.
    number
        Of the part, from 0.
    count
        How many parts there are.
    """

    def report(fraction: float) -> None:
        if progress is not None:
            progress((number + fraction) / count)

    return report


def within(progress: ProgressCallback | None, start: float, length: float) -> ProgressCallback:
    """Callback for a part of the work that begins at a fraction of it and is as long as another."""

    def report(fraction: float) -> None:
        if progress is not None:
            progress(start + length * fraction)

    return report


class Pace:
    """Time that a piece of work still takes, by the pace that it has had so far."""

    def __init__(self) -> None:
        self._work, self._begun, self._from = "", 0.0, 0.0

    def seconds_left(self, what: str, fraction: float) -> float | None:
        """By what is done of a piece of work, from 0 to 1; None where nothing tells yet.

        Other work than before, or less of it, begins anew.
        """
        now = time.perf_counter()
        if what != self._work or fraction < self._from:
            self._work, self._begun, self._from = what, now, fraction
        gone = fraction - self._from
        return (now - self._begun) * (1 - fraction) / gone if gone > 0 else None

    def per_second(self, fraction: float) -> float:
        """Fraction of the work that is done in a second; 0 where nothing tells yet."""
        elapsed = time.perf_counter() - self._begun
        return (fraction - self._from) / elapsed if elapsed > 0 else 0.0

    @property
    def sure(self) -> bool:
        """Whether the work has gone on for long enough that its pace is believed."""
        return time.perf_counter() - self._begun > _RELIABLE_AFTER_S


def _now() -> str:
    return datetime.now(UTC).astimezone().isoformat(timespec="seconds")


@dataclass(frozen=True)
class Clock:
    """Starts when it is made.

    Attributes
    ----------
    started
        ISO 8601, with the offset from UTC.
    """

    started: str = field(default_factory=_now)
    _from: float = field(default_factory=time.perf_counter)

    @property
    def seconds(self) -> float:
        """Since then."""
        return round(time.perf_counter() - self._from, 3)
