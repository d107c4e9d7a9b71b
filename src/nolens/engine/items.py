"""Items of work, one by one through workers: bounded in number, tried again, in any order."""

import os
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterable
from contextlib import closing
from dataclasses import dataclass
from itertools import chain
from typing import Any, Protocol

import psutil

from nolens.errors import NolensError

ATTEMPTS = 3
"""How often an item is tried before it counts as failed."""
AHEAD = 2
"""Items that a worker has at once: the one it works on, and the next."""
_MEMORY_USED = 0.8

Load = Callable[[], Any]
"""Gives an item; called in the command's process when a worker is to get it."""


class Work(Protocol):
    """What is done with every item; it is pickled, and sent to each worker once."""

    def prepare(self) -> Callable[[Any], Any]:
        """Do in a worker what is the same for all items, and give what is called with each.

        Items and answers are pickled. The answer may depend on nothing but the item.
        """


@dataclass(frozen=True)
class Outcome:
    """What became of an item.

    Parameters
    ----------
    key
        Of the item.
    value
        The answer; None where it failed.
    error
        Why it failed the last time; empty where it did not.
    attempts
        How often it was tried.
    """

    key: str
    value: Any
    error: str
    attempts: int


@dataclass(frozen=True)
class Failure:
    """An answer that is none: the error's text, and whether work on the item had begun."""

    text: str
    begun: bool = True


class Executor(Protocol):
    """Workers behind one channel."""

    @property
    def capacity(self) -> int:
        """Items that may be with the workers at once."""

    def submit(self, key: str, item: Any) -> None:
        """Send an item."""

    def next(self) -> tuple[str, Any]:
        """Wait for an answer, or a `Failure`, to any item that was sent."""

    def close(self) -> None:
        """End the work, whatever is still under way."""


def run_items(
    items: Iterable[tuple[str, Load]],
    work: Work,
    *,
    workers: int = 1,
    scheduler: str | None = None,
    note: Callable[[str], None] = lambda text: None,
) -> Generator[Outcome]:
    """Do the work with every item, and give what came of each as soon as it is known.

    An item is loaded when a worker is free for it, and is gone when its outcome is: memory does
    not depend on how many there are. One that fails, or whose worker dies, is loaded and tried
    again, up to three times. Closing the iterator ends all workers at once.

    Parameters
    ----------
    items
        A key for each, and what loads it.
    work
        The work.
    workers
        Processes of this machine, each with one thread; used where there is no scheduler.
    scheduler
        Address (``tcp://host:8786``) or scheduler file of a Dask cluster, whose workers need the
        same version of nolens, and no folder in common with this machine.
    note
        Is told what a person at a terminal should know.

    Raises
    ------
    NolensError
        If there is no scheduler at that address, its workers have another version of nolens, or
        the work cannot be prepared.
    """
    fresh, again = iter(items), deque[str]()
    first = next(fresh, None)
    if first is None:
        return
    fresh = chain((first,), fresh)
    with closing(_executor(work, workers, scheduler, note)) as executor:
        loads: dict[str, Load] = {}
        tries: Counter[str] = Counter()
        running = 0
        while True:
            failed: tuple[str, Failure] | None = None
            while running < executor.capacity and failed is None:
                key = again.popleft() if again else None
                if key is None:
                    following = next(fresh, None)
                    if following is None:
                        break
                    key, loads[following[0]] = following
                tries[key] += 1
                try:
                    item = loads[key]()
                except Exception as error:
                    failed = key, failure(error)
                else:
                    executor.submit(key, item)
                    running += 1
            if failed is None:
                if running == 0:
                    return
                key, value = executor.next()
                running -= 1
            else:
                key, value = failed
            if isinstance(value, Failure):
                tries[key] -= not value.begun
                if tries[key] < ATTEMPTS:
                    again.append(key)
                    continue
            del loads[key]
            reason = value.text if isinstance(value, Failure) else ""
            yield Outcome(key, None if reason else value, reason, tries.pop(key))


def check_scheduler(scheduler: str | None) -> None:
    """Refuse a scheduler that does not answer, before anything is prepared for it.

    Parameters
    ----------
    scheduler
        As for `run_items`.

    Raises
    ------
    OptionError
        If it does not answer within some seconds, or Dask is not installed.
    """
    if scheduler is not None:
        from nolens.engine.cluster import reached

        reached(scheduler)


def failure(error: Exception) -> Failure:
    """What is told of an error: its text, and its kind where it is none of ours."""
    known = isinstance(error, NolensError)
    return Failure(str(error) if known else f"{type(error).__name__}: {error}")


def worker_count(needed: float) -> int:
    """Processes that this machine has cores and free memory for; one at least.

    Parameters
    ----------
    needed
        Bytes that each holds at once.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    cores = (os.cpu_count() or 1) if affinity is None else len(affinity(0))
    room = _MEMORY_USED * psutil.virtual_memory().available / needed
    return max(1, min(cores, int(room)))


def _executor(
    work: Work, workers: int, scheduler: str | None, note: Callable[[str], None]
) -> Executor:
    if scheduler is None:
        from nolens.engine.processes import Processes

        return Processes(work, workers)
    from nolens.engine.cluster import Cluster

    return Cluster(work, scheduler, note)
