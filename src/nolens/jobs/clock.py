"""When a job began, and how long it has taken."""

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
