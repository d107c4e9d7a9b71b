"""A process beside the server: both send messages, it answers requests, and it may die."""

import asyncio
import faulthandler
import importlib
import os
import queue
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any

from nolens.errors import NolensError
from nolens.files.input import read_limit, set_read_limit
from nolens.process import prepare, without_ctrl_c, worker_context
from nolens.studio.workspace import confine

Message = tuple[Any, ...]
"""A message: plain values, the first of which says what it is about."""

_LOADED = ("nolens.studio.live_process", "nolens.studio.job_process")
_LAST_LINES = 8
_MOST_WAITING = 1000


class RefusedError(NolensError):
    """What a worker answers to what it cannot do; its text is for a person."""


class WorkerDiedError(RefusedError):
    """A worker ended before it answered."""


class NoAnswerError(RefusedError):
    """A worker did not answer in time."""


class Worker:
    """A process with a channel in both directions. Make it where an event loop runs.

    Parameters
    ----------
    name
        Of the process.
    target
        ``"module:function"``, imported in the process alone; called with its `Channel`.
    folders
        Out of which it opens nothing through links (`confine`).
    on_message
        Called with every message of its own accord, in a thread of the worker's.
    on_end
        Called in the event loop with the reason, once, when it is gone.
    """

    def __init__(
        self,
        name: str,
        target: str,
        folders: Sequence[str],
        on_message: Callable[[Message], None],
        on_end: Callable[[str], None],
    ) -> None:
        self._loop = asyncio.get_running_loop()
        self._on_message, self._on_end = on_message, on_end
        self._requests: dict[int, asyncio.Future[Any]] = {}
        self._number = 0
        self._waiting: deque[tuple[str | None, Message]] = deque()
        self._changed = threading.Condition()
        self._gone = threading.Event()
        self._errors: deque[str] = deque(maxlen=_LAST_LINES)
        context = worker_context(*_LOADED)
        self._channel, theirs = context.Pipe()
        self._stderr, their_stderr = context.Pipe(duplex=False)
        self._process = context.Process(
            target=_begin,
            args=(target, folders, theirs, their_stderr, read_limit()),
            name=name,
            daemon=True,
        )
        self._killed = False
        threading.Thread(target=self._send_all, daemon=True).start()
        ends = theirs, their_stderr
        threading.Thread(target=self._follow, args=ends, daemon=True).start()

    @property
    def pid(self) -> int | None:
        """Number of the process; None while it starts."""
        return self._process.pid

    def send(self, *message: Any, instead: str | None = None) -> None:
        """Send a message, without waiting.

        Parameters
        ----------
        message
            Plain values.
        instead
            A name: the message takes the place of one with the same name that was not sent yet.

        Raises
        ------
        RefusedError
            If the process does not take its messages any more.
        """
        with self._changed:
            if instead is not None:
                self._waiting = deque(each for each in self._waiting if each[0] != instead)
            if len(self._waiting) >= _MOST_WAITING:
                raise RefusedError("it has not answered for long; stop it and start it again")
            self._waiting.append((instead, message))
            self._changed.notify()

    async def request(self, *message: Any, seconds: float) -> Any:
        """Send a message, and wait for what the process answers.

        Raises
        ------
        RefusedError
            With what it answers instead.
        NoAnswerError, WorkerDiedError
            If it does not answer in time, or ends.
        """
        if self._gone.is_set():
            raise WorkerDiedError("it has ended")
        self._number += 1
        number, future = self._number, self._loop.create_future()
        self._requests[number] = future
        try:
            self.send("request", number, *message)
            async with asyncio.timeout(seconds):
                return await future
        except TimeoutError:
            raise NoAnswerError(f"no answer within {seconds:g} s: try again, or stop it") from None
        finally:
            del self._requests[number]

    async def stop(self, grace_s: float) -> None:
        """Ask the process to end, and kill it where it does not."""
        with suppress(RefusedError):
            self.send("end")
        if not await asyncio.to_thread(self._gone.wait, grace_s):
            self.kill()
            await asyncio.to_thread(self._gone.wait, 2.0)

    def kill(self) -> None:
        """End the process at once, or as soon as it has started."""
        with self._changed:
            self._killed = True
            if self.pid is None:
                return
        with suppress(ValueError, OSError):
            self._process.kill()

    def _send_all(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._gone.is_set())
                if self._gone.is_set():
                    return
                _, message = self._waiting.popleft()
            try:
                self._channel.send(message)
            # A message that cannot be sent leaves both sides of different minds: start again.
            except Exception:
                self.kill()
                return

    def _follow(self, *theirs: Connection) -> None:
        """From its start, for which nothing else waits, to its end."""
        reason = self._start(*theirs) or self._listen()
        with self._changed:
            self._gone.set()
            self._changed.notify()
        self._channel.close()
        self._in_loop(self._over, reason)

    def _start(self, *theirs: Connection) -> str | None:
        """Start it; why it did not, where it did not."""
        try:
            with without_ctrl_c():
                self._process.start()
        except (OSError, EOFError) as error:
            return f"did not start: {error}"
        finally:
            for each in theirs:
                each.close()
        with self._changed:
            killed = self._killed
        if killed:
            self.kill()
        return None

    def _listen(self) -> str:
        """Take what it sends, to its end; why it ended."""
        stderr_thread = threading.Thread(target=self._read_stderr, daemon=True)
        stderr_thread.start()
        # Whatever cannot be read, as what a killed process had half sent, is the end too.
        with suppress(Exception):
            while True:
                message = self._channel.recv()
                if message[0] == "answer":
                    self._in_loop(self._answered, *message[1:])
                else:
                    self._on_message(message)
        self._process.join(2.0)
        if self._process.exitcode is None:
            self._process.kill()
            self._process.join()
        stderr_thread.join(1.0)
        return self._reason()

    def _read_stderr(self) -> None:
        """Keep the last lines of its standard error."""
        rest = b""
        with suppress(OSError):
            while data := os.read(self._stderr.fileno(), 65536):
                *lines, rest = (rest + data).split(b"\n")
                rest = rest[-1000:]
                self._errors.extend(_line(each) for each in lines if each.strip())
        if rest.strip():
            self._errors.append(_line(rest))
        self._stderr.close()

    def _reason(self) -> str:
        code = self._process.exitcode or 0
        if code < 0:
            text = f"was killed ({signal.Signals(-code).name})"
            if -code == signal.SIGKILL:
                text += ", as the system does where memory runs out"
        else:
            text = f"ended (exit code {code})"
        stderr = "; ".join(self._errors)
        return f"{text}: {stderr}" if stderr else text

    def _in_loop(self, call: Callable[..., None], *arguments: Any) -> None:
        with suppress(RuntimeError):  # The loop is closed: nobody waits any more.
            self._loop.call_soon_threadsafe(call, *arguments)

    def _answered(self, number: int, result: Any, refused: str | None) -> None:
        future = self._requests.get(number)
        if future is None or future.done():
            return
        if refused is None:
            future.set_result(result)
        else:
            future.set_exception(RefusedError(refused))

    def _over(self, reason: str) -> None:
        for future in self._requests.values():
            if not future.done():
                future.set_exception(WorkerDiedError(f"the process {reason}"))
        self._on_end(reason)


class Channel:
    """The worker's end: what it receives, and how it answers. Threads may share it.

    Parameters
    ----------
    connection
        To the server.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self._lock = threading.Lock()
        self._received: queue.SimpleQueue[Message | None] = queue.SimpleQueue()
        threading.Thread(target=self._listen, name="channel", daemon=True).start()

    def send(self, *message: Any) -> None:
        """Send a message to the server; a server that is gone ends the process."""
        try:
            with self._lock:
                self._connection.send(message)
        except OSError:
            os._exit(0)

    def answer(self, number: int, result: Any = None, *, refused: str | None = None) -> None:
        """Answer the request of a number."""
        self.send("answer", number, result, refused)

    def messages(self) -> Iterator[Message]:
        """What the server sends, to its end; what it requests is ``("request", number, ...)``."""
        while (message := self._received.get()) is not None:
            yield message

    def _listen(self) -> None:
        """From the first moment on, so that the process goes with the server."""
        try:
            while (message := self._connection.recv())[0] != "end":
                self._received.put(message)
        except (EOFError, OSError):
            os._exit(0)
        self._received.put(None)


def _begin(
    target: str, folders: Sequence[str], connection: Connection, stderr: Connection, limit: int
) -> None:
    """What the process does first and last."""
    os.dup2(stderr.fileno(), 2)
    stderr.close()
    faulthandler.enable()
    prepare()
    confine(folders)
    set_read_limit(limit)
    module, name = target.split(":")
    getattr(importlib.import_module(module), name)(Channel(connection))


def _line(data: bytes) -> str:
    return data.decode("utf-8", "replace").strip()[:300]
