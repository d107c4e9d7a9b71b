"""Work for workers: squares, with an item that fails and one that kills its worker."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

FAILS, KILLS = 3, 5


@dataclass(frozen=True)
class Squares:
    """Of whole numbers; `memory` remembers that a worker was killed."""

    memory: Path | None = None

    def prepare(self) -> Callable[[int], int]:
        return self._square

    def _square(self, number: int) -> int:
        if number == FAILS:
            raise ValueError("three is refused")
        if number == KILLS and self.memory is not None and not self.memory.exists():
            self.memory.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        return number * number


class Unreadable(int):
    """A number that no worker can unpack."""

    def __reduce__(self) -> object:
        return _refuse, ()


def _refuse() -> None:
    raise ValueError("cannot be unpacked")
