"""The process that works on jobs, one at a time; it checks others meanwhile."""

import math
import os
import queue
import threading
import time
import traceback
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from nolens.errors import NolensError
from nolens.jobs import Reporter
from nolens.jobs.run import Pace
from nolens.solvers import Progress
from nolens.studio.job_build import Place, build, declarations
from nolens.studio.schemas import JobKind
from nolens.studio.worker import Channel, Told

_EVERY_S = 0.1


class _CancelledError(BaseException):
    """A person cancelled work that does not go in steps: nothing of it is kept."""


def main(channel: Channel) -> None:
    """Do what the server tells, until it tells to end."""
    work: queue.SimpleQueue[Told | None] = queue.SimpleQueue()
    cancelled = _Cancelled()
    threading.Thread(target=_listen, args=(channel, work, cancelled), daemon=True).start()
    while (message := work.get()) is not None:
        _, identity, kind, given, folder = message
        _work(channel, cancelled, Place(Path(folder), identity), kind, given)


class _Cancelled:
    """Which jobs were cancelled."""

    def __init__(self) -> None:
        self._names: set[str] = set()

    def add(self, identity: str) -> None:
        self._names.add(identity)

    def __contains__(self, identity: str) -> bool:
        return identity in self._names


def _listen(
    channel: Channel, work: "queue.SimpleQueue[Told | None]", cancelled: _Cancelled
) -> None:
    for message in channel.messages():
        if message[0] == "run":
            work.put(message)
        elif message[0] == "cancel":
            cancelled.add(message[1])
        elif message[0] == "asked" and message[2] == "declarations":
            _answer(channel, message[1], declarations)
        elif message[0] == "asked":
            _, number, _, identity, kind, given, folder = message
            place = Place(Path(folder), identity)
            _answer(channel, number, partial(_check, kind, given, place))
    # Work that is going on would hold the process for as long as it takes.
    os._exit(0)


def _check(kind: JobKind, given: dict[str, Any], place: Place) -> None:
    build(kind, given, place)


def _answer(channel: Channel, number: int, work: Callable[[], Any]) -> None:
    """Answer with what some work gives, or with what is wrong."""
    try:
        answer = work()
    except NolensError as error:
        channel.answer(number, refused=str(error))
    except Exception as error:
        traceback.print_exc()
        channel.answer(number, refused=f"a bug in nolens: {type(error).__name__}: {error}")
    else:
        channel.answer(number, answer)


def _work(
    channel: Channel, cancelled: _Cancelled, place: Place, kind: JobKind, given: dict[str, Any]
) -> None:
    reporter = ChannelReporter(channel, place.id, cancelled)
    try:
        job = build(kind, given, place)
        job.make_folder()
        summary = _finite(job.run(reporter))
    except _CancelledError:
        channel.tell("cancelled", place.id, None)
    except NolensError as error:
        channel.tell("failed", place.id, str(error))
    except MemoryError:
        channel.tell("failed", place.id, "there is not enough memory for this")
    except Exception as error:
        traceback.print_exc()
        where = traceback.extract_tb(error.__traceback__)[-1]
        channel.tell(
            "failed",
            place.id,
            f"this is a bug in nolens: {type(error).__name__}: {error} "
            f"({Path(where.filename).name}, line {where.lineno})",
        )
    else:
        reporter.flush()
        ended = "cancelled" if reporter.stopped else "done"
        channel.tell(ended, place.id, summary)


class ChannelReporter(Reporter):
    """Tells the server how far a job is; whoever waits there may cancel it.

    Parameters
    ----------
    channel
        To the server.
    identity
        Of the job.
    cancelled
        Jobs that were cancelled.
    """

    def __init__(self, channel: Channel, identity: str, cancelled: _Cancelled) -> None:
        self.stopped = False
        self._channel, self._identity, self._cancelled = channel, identity, cancelled
        self._rows: list[dict[str, float | None]] = []
        self._told = 0.0
        self._work, self._pace = "", Pace()

    def note(self, text: str) -> None:
        """Say something a person should know before it happens."""
        self._channel.tell("note", self._identity, text)
        self._check()

    def warn(self, text: str) -> None:
        """Say what may make the result worse than it could be."""
        self._channel.tell("warning", self._identity, text)

    def advance(self, what: str, share: float) -> None:
        """Tell how much of a piece of work is done; a cancelled one ends here."""
        self._check()
        self._progress(what, share, None, None)

    def step(self, what: str, done: int, limit: int, kept: str) -> bool:
        """Tell how many steps are done; True ends a cancelled job."""
        self._progress(what, done / limit, done, limit)
        self.stopped = self._identity in self._cancelled
        return self.stopped

    def progress(self, progress: Progress, limit: int) -> bool:
        """Tell an iteration; True ends a cancelled job."""
        row = {
            "iteration": progress.iteration,
            "objective": progress.objective,
            "residual": progress.residual,
            "scene_step": progress.scene_change,
        }
        self._rows.append({name: _number(value) for name, value in row.items()})
        return self.step("iteration", progress.iteration, limit, "the picture")

    def flush(self) -> None:
        """Tell what was held back."""
        if self._rows:
            self._channel.tell("rows", self._identity, self._rows)
            self._rows = []

    def _check(self) -> None:
        if self._identity in self._cancelled:
            raise _CancelledError

    def _progress(self, what: str, share: float, done: int | None, limit: int | None) -> None:
        now, left = time.monotonic(), self._pace.seconds_left(what, share)
        if now - self._told < _EVERY_S and share < 1 and what == self._work:
            return
        self._told, self._work = now, what
        self.flush()
        told = {"what": what, "share": share, "done": done, "limit": limit, "seconds_left": left}
        self._channel.tell("progress", self._identity, told)


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _finite(value: Any) -> Any:
    """A value as JSON has it: NaN and infinity are nothing, tuples are lists."""
    if isinstance(value, dict):
        return {str(key): _finite(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(each) for each in value]
    return _number(value) if isinstance(value, float) else value
