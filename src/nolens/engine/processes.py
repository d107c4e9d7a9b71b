"""Worker processes of this machine."""

import os
import queue
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any

from nolens.engine.items import AHEAD, Failure, Work, failure
from nolens.errors import NolensError, OptionError
from nolens.files.input import read_limit, set_read_limit
from nolens.process import prepare, without_ctrl_c, worker_context

_DEATHS_AT_START = 3
_READY = "ready"


class Processes:
    """As many processes as asked for, each of which is replaced when it dies.

    Parameters
    ----------
    work
        The work.
    count
        How many.
    """

    def __init__(self, work: Work, count: int) -> None:
        self._work = work
        self._answers = deque[tuple[str, Any]]()
        self._deaths = 0
        self._workers: list[_Process] = []
        for _ in range(count):
            self._workers.append(_Process(work))

    @property
    def capacity(self) -> int:
        """Items that may be with the processes at once."""
        return AHEAD * len(self._workers)

    def submit(self, key: str, item: Any) -> None:
        """Send an item to the process that has fewest."""
        worker = min(self._workers, key=lambda each: len(each.keys))
        worker.keys.append(key)
        with suppress(OSError):  # One that has died is replaced when its end is seen.
            worker.connection.send((key, item))

    def next(self) -> tuple[str, Any]:
        """Wait for an answer.

        Raises
        ------
        NolensError
            If the work cannot be prepared, or processes die while they prepare it.
        """
        while not self._answers:
            by_connection = {each.connection: each for each in self._workers}
            for connection in wait(list(by_connection)):
                assert isinstance(connection, Connection)
                self._receive(by_connection[connection])
        return self._answers.popleft()

    def _receive(self, worker: "_Process") -> None:
        try:
            key, answer = worker.connection.recv()
        except (EOFError, OSError):
            self._replace(worker)
            return
        if key == _READY:
            if isinstance(answer, Exception):
                raise answer
            worker.ready, self._deaths = True, 0
            return
        worker.keys.remove(key)
        self._answers.append((key, answer))

    def _replace(self, worker: "_Process") -> None:
        """Start another, and say of each item whether the dead one had begun with it."""
        code = worker.end()
        if not worker.ready:
            self._deaths += 1
        if self._deaths >= _DEATHS_AT_START:
            raise OptionError(
                f"{_DEATHS_AT_START} worker processes ended as they began ({_how(code)}): the "
                "machine may have too little memory; give fewer --workers"
            )
        place = self._workers.index(worker)
        self._workers[place] = _Process(self._work)
        text = f"the worker process ended ({_how(code)})"
        self._answers += [
            (key, Failure(text, begun=worker.ready and number == 0))
            for number, key in enumerate(worker.keys)
        ]

    def close(self) -> None:
        """End all processes at once."""
        for each in self._workers:
            each.end()


class _Process:
    """A process, and the keys of the items that it has."""

    def __init__(self, work: Work) -> None:
        context = worker_context("torch", type(work).__module__)
        self.connection, theirs = context.Pipe()
        self.keys: list[str] = []
        self.ready = False
        self._process = context.Process(
            target=_serve, args=(theirs, work, read_limit()), daemon=True
        )
        with without_ctrl_c():
            self._process.start()
        theirs.close()

    def end(self) -> int:
        """End it; its exit code."""
        self.connection.close()
        self._process.kill()
        self._process.join()
        return self._process.exitcode or 0


def _how(code: int) -> str:
    return f"signal {-code}" if code < 0 else f"exit code {code}"


def _serve(connection: Connection, work: Work, limit: int) -> None:
    """What a process does."""
    received = queue.SimpleQueue[tuple[str, Any]]()
    threading.Thread(target=_listen, args=(connection, received), daemon=True).start()
    prepare()
    set_read_limit(limit)
    import torch

    # The answers are to be the same, whatever the number of processes.
    torch.set_num_threads(1)
    try:
        call: Callable[[Any], Any] = work.prepare()
    except NolensError as error:
        _send(connection, _READY, error)
        return
    _send(connection, _READY, None)
    while True:
        key, item = received.get()
        try:
            answer = call(item)
        except Exception as error:
            answer = failure(error)
        _send(connection, key, answer)


def _send(connection: Connection, key: str, answer: Any) -> None:
    try:
        connection.send((key, answer))
    except OSError:
        os._exit(0)  # The command is gone.


def _listen(connection: Connection, received: "queue.SimpleQueue[tuple[str, Any]]") -> None:
    """Take the next item while one is worked on, and end with the command."""
    with suppress(EOFError, OSError):
        while True:
            received.put(connection.recv())
    os._exit(0)
