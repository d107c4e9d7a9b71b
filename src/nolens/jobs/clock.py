"""When a job began, how long it has taken, and how long it will still take."""

import time
from dataclasses import dataclass, field
from datetime import UTC, datetime


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


_SURE_S = 5.0


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

    @property
    def sure(self) -> bool:
        """Whether the work has gone on for long enough that its pace is believed."""
        return time.perf_counter() - self._begun > _SURE_S


def duration_text(seconds: float) -> str:
    """Say how long, in the unit that suits."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
