"""Workers of a Dask cluster."""

import asyncio
import importlib.metadata
import json
import logging
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any
from uuid import uuid4

from nolens.engine.items import AHEAD, Failure, Work, failure
from nolens.errors import FileError, NolensError, OptionError
from nolens.process import prepare

try:
    import dask
    from distributed import Client, Future, WorkerPlugin, as_completed
    from distributed.comm.core import connect
    from distributed.scheduler import KilledWorker
    from distributed.security import Security
except ImportError:
    raise OptionError(
        "--scheduler needs Dask, which is not installed: pip install 'nolens[cluster]'"
    ) from None

# Our words say what matters, and frames are sent as they are, however large.
for _name in ("distributed", "distributed.client"):
    logging.getLogger(_name).setLevel(logging.CRITICAL)
dask.config.set({"distributed.admin.large-graph-warning-threshold": "1 TiB"})

_LOGS = {"distributed.admin.low-level-log-length": 1}
"""Dask keeps its last 1000 messages below 1 MB to each worker, and the frames with them."""

_SECONDS = 2.5
"""For a scheduler to answer."""
_COUNT_AGAIN_S = 2.0
"""After which workers are counted again."""
_TASK_S = 1.0
"""Work that a task has at least, as the cluster takes 10 ms of processors for each."""
_MOST_ITEMS = 8
"""In a task, of which workers hold two."""
_MEASUREMENTS = {"tick": 1e3, "profile": 1e3, "profile-cycle": 60e3}
"""Milliseconds, at least, from one look of Dask at its event loop, or at the functions that run, to
the next, and between entries of their history: 20, 10 and 1000 ms are a twentieth of two cores."""
_prepared: dict[str, Callable[[Any], Any] | Exception] = {}
"""What is called with an item, by run, or why it could not be prepared; of this worker."""


class Cluster:
    """The workers of a scheduler, those that join later among them.

    The work goes to each worker once, as a plugin, which the scheduler keeps for later ones. Items
    that take a short time are sent several in a task; those whose worker died, one by one, so that
    it is known which of them ends workers.

    Parameters
    ----------
    work
        The work.
    scheduler
        Address or scheduler file.
    note
        Is told where the dashboard is, and of waiting for workers.
    """

    def __init__(self, work: Work, scheduler: str, note: Callable[[str], None]) -> None:
        self._scheduler, self._run = scheduler, uuid4().hex
        with dask.config.set(_LOGS):
            self._client = Client(reached(scheduler), timeout=_SECONDS, set_as_default=False)
        try:
            with self._reaching():
                self._prepare(work, note)
        except BaseException:
            with suppress(Exception):
                self._client.close(timeout=_SECONDS)
            raise
        self._threads, self._counted = 1, -_COUNT_AGAIN_S
        self._items_of_task = 1
        self._gathered: list[tuple[str, Any]] = []
        self._alone = set[str]()
        self._running: dict[Future[Any], list[str]] = {}
        self._answers = deque[tuple[str, Any]]()
        self._completed = as_completed(loop=self._client.loop)

    def _prepare(self, work: Work, note: Callable[[str], None]) -> None:
        about = self._client.scheduler_info(n_workers=-1)
        if "dashboard" in about["services"]:
            note(f"the cluster's dashboard is at {self._client.dashboard_link}")
        if not about["workers"]:
            note(f"waiting for workers of {self._scheduler}: none has joined yet")
            self._client.wait_for_workers(1)
        self._client.run_on_scheduler(_relieve)
        self._check_versions()
        self._client.register_plugin(_Preparation(self._run, work), name=self._run)
        self._check_preparation()

    @property
    def capacity(self) -> int:
        """Items that may be with the workers at once, of which more may have joined."""
        now = time.monotonic()
        if now > self._counted + _COUNT_AGAIN_S:
            with self._reaching():
                workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            self._threads = max(1, sum(int(each["nthreads"]) for each in workers))
            self._counted = now
        return AHEAD * self._threads * self._items_of_task

    def submit(self, key: str, item: Any) -> None:
        """Send an item to any worker, with others where there are enough for a task."""
        if key in self._alone:
            self._send([(key, item)])
            return
        self._gathered.append((key, item))
        if len(self._gathered) >= self._items_of_task:
            self._send_gathered()

    def _send_gathered(self) -> None:
        if self._gathered:
            self._send(self._gathered)
            self._gathered = []

    def _send(self, items: Sequence[tuple[str, Any]]) -> None:
        name, each = f"nolens-{uuid4().hex}", [item for _, item in items]
        with self._reaching():
            future = self._client.submit(_call, self._run, each, key=name, pure=False)
            self._completed.add(future)
        self._running[future] = [key for key, _ in items]

    def next(self) -> tuple[str, Any]:
        """Wait for an answer.

        Raises
        ------
        FileError
            If the scheduler has gone.
        NolensError
            If a worker joined that cannot do the work, such as one of another version.
        """
        while not self._answers:
            # Small tasks would stay small: they go only where workers would have nothing to do.
            if len(self._running) < self._threads:
                self._send_gathered()
            with self._reaching():
                future = next(self._completed)
                self._answers += self._answers_of(future, self._running.pop(future))
        return self._answers.popleft()

    def _answers_of(self, future: "Future[Any]", keys: list[str]) -> Iterable[tuple[str, Any]]:
        if future.status == "finished":
            seconds, answers = future.result()
            self._items_of_task = max(
                1, min(_MOST_ITEMS, int(_TASK_S * len(keys) / max(seconds, 1e-6)))
            )
            return zip(keys, answers, strict=True)
        error = future.exception() if future.status == "error" else None
        if error is None and self._client.status != "running":
            raise ConnectionError
        if isinstance(error, NolensError):  # Of a worker that joined: it would fail all items.
            raise error
        self._alone.update(keys)
        begun = len(keys) == 1
        if error is None or isinstance(error, KilledWorker):
            reason = Failure("the worker ended before it had an answer", begun)
        else:
            reason = Failure(failure(error).text, begun)
        return [(key, reason) for key in keys]

    @contextmanager
    def _reaching(self) -> Iterator[None]:
        """Say so where the scheduler has gone, which the client shows by errors of many kinds."""
        try:
            yield
        except (Exception, asyncio.CancelledError) as error:
            if self._client.status == "running" and self._answers_still():
                raise
            raise FileError(
                f"the scheduler {self._scheduler} has gone. What was written is kept: run the same "
                "command again when there is one"
            ) from error

    def _answers_still(self) -> bool:
        try:
            return bool(reached(self._scheduler))
        except OptionError:
            return False

    def close(self) -> None:
        """Take back what is under way, and leave the cluster to others."""
        with suppress(Exception):  # The scheduler may go at any moment.
            if self._client.status == "running":
                self._client.cancel(list(self._running), force=True)
                self._client.unregister_worker_plugin(self._run)
            self._client.close(timeout=_SECONDS)

    def _check_versions(self) -> None:
        """Refuse workers of another version than this one's."""
        here = importlib.metadata.version("nolens")
        found = self._client.run(importlib.metadata.version, "nolens", on_error="return")
        for worker, there in found.items():
            if isinstance(there, importlib.metadata.PackageNotFoundError):
                raise OptionError(
                    f"the worker {worker} has no nolens, and this is {here}: install "
                    f"nolens=={here} there"
                )
            _check_version(f"the worker {worker}", here, there)

    def _check_preparation(self) -> None:
        for error in self._client.run(_state, self._run).values():
            if error is not None:
                raise error


def _check_version(worker: str, here: str, there: object) -> None:
    if there != here:
        raise OptionError(
            f"{worker} has nolens {there}, and the command {here}: install the same version on both"
        )


def reached(scheduler: str) -> str:
    """Address of a scheduler that answers, given its address or the file that describes it.

    Raises
    ------
    OptionError
        If there is none.
    """
    address = scheduler
    if "://" not in scheduler:
        try:
            address = json.loads(Path(scheduler).read_text())["address"]
        except (OSError, ValueError, KeyError, TypeError):
            raise OptionError(
                f"--scheduler {scheduler} is neither an address, such as tcp://host:8786, nor a "
                "scheduler file"
            ) from None
    try:
        # In another thread: that of a notebook runs an event loop already, and takes no second one.
        with ThreadPoolExecutor(1) as thread:
            thread.submit(asyncio.run, asyncio.wait_for(_greet(address), _SECONDS)).result()
    except Exception:  # Whatever else listens there may answer anything.
        raise OptionError(
            f"no Dask scheduler answers at {address} within {_SECONDS:g} s: start one (dask "
            "scheduler), or give the address that it prints (not that of its dashboard)"
        ) from None
    return address


async def _greet(address: str) -> None:
    greeting = await connect(address, **Security().get_connection_args("client"))
    await greeting.close()


class _Preparation(WorkerPlugin):
    """Prepares the work in a worker when it gets it, or joins."""

    def __init__(self, run: str, work: Work) -> None:
        self._name, self._work = run, work
        self._version = importlib.metadata.version("nolens")

    def setup(self, worker: Any) -> None:
        """Prepare it; an error is kept for whoever asks."""
        import torch

        # The answers are to be the same, whatever the workers have of cores.
        torch.set_num_threads(1)
        prepare()
        self._timers = _measure_less(worker)
        try:
            # Workers that join later are checked here.
            there = importlib.metadata.version("nolens")
            _check_version(f"the worker {worker.address}", self._version, there)
            _prepared[self._name] = self._work.prepare()
        except Exception as error:
            _prepared[self._name] = error

    def teardown(self, worker: Any) -> None:
        """Let go of it."""
        for timer, before_ms in self._timers.items():
            timer.callback_time = before_ms
        _prepared.pop(self._name, None)


def _state(run: str) -> Exception | None:
    call = _prepared.get(run)
    return call if isinstance(call, Exception) else None


def _measure_less(server: Any) -> dict[Any, float]:
    """Let a scheduler or worker measure itself less often; its timers, with the times before."""
    timers = server.periodic_callbacks
    slower = {
        timers[name]: ms
        for name, ms in _MEASUREMENTS.items()
        if name in timers and timers[name].callback_time < ms
    }
    before = {timer: timer.callback_time for timer in slower}
    for timer, ms in slower.items():
        timer.callback_time = ms
    return before


def _relieve(dask_scheduler: Any) -> None:
    """Let the scheduler keep no frames in its logs of messages, to workers that join later either.

    Only who searches for faults of Dask itself reads these, and what it measures of itself.
    """
    _measure_less(dask_scheduler)
    dask.config.set(_LOGS)
    for stream in dask_scheduler.stream_comms.values():
        stream.recent_message_log = deque(maxlen=1)


def _call(run: str, items: Sequence[Any]) -> tuple[float, list[Any]]:
    """Seconds that the items took, and their answers."""
    call = _prepared[run]
    if isinstance(call, Exception):
        raise call
    begun, answers = time.perf_counter(), []
    for item in items:
        try:
            answers.append(call(item))
        except Exception as error:
            answers.append(failure(error))
    return time.perf_counter() - begun, answers
