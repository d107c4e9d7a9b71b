"""Waiting for what must happen: a machine may be slow, or busy with something else."""

import time
from collections.abc import Callable
from typing import TypeVar

T = TypeVar("T")

PATIENCE_S = 900.0
"""Far longer than anything takes; only what has failed lasts as long."""


def until(happens: Callable[[], T], what: str, seconds: float = PATIENCE_S) -> T:
    """What a call gives, once it is true."""
    end = time.monotonic() + seconds
    while not (found := happens()):
        assert time.monotonic() < end, what
        time.sleep(0.02)
    return found
