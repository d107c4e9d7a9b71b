"""Workers of a Dask cluster."""

import importlib.metadata
import json
import logging
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any
from uuid import uuid4

from nolens.engine.items import AHEAD, Failure, Work, failure
from nolens.errors import FileError, OptionError

try:
    from distributed import Client, Future, WorkerPlugin, as_completed
    from distributed.scheduler import KilledWorker
except ImportError:
    raise OptionError(
        "--scheduler needs Dask, which is not installed: pip install 'nolens[cluster]'"
    ) from None

_SECONDS = 3.0
"""For a scheduler to answer."""
_COUNT_AGAIN_S = 2.0
"""After which workers are counted again."""
_prepared: dict[str, Callable[[Any], Any]] = {}
"""What is called with an item, by run; of this worker."""


class Cluster:
    """The workers of a scheduler, those that join later among them.

    The work goes to each worker once, as a plugin, which the scheduler keeps for later ones.

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
        logging.getLogger("distributed").setLevel(logging.CRITICAL)
        self._scheduler, self._run = scheduler, uuid4().hex
        self._client = _connected(scheduler)
        try:
            about = self._client.scheduler_info(n_workers=-1)
            if "dashboard" in about["services"]:
                note(f"the cluster's dashboard is at {self._client.dashboard_link}")
            if not about["workers"]:
                note(f"waiting for workers of {scheduler}: none has joined yet")
                self._client.wait_for_workers(1)
            self._check_versions()
            self._client.register_plugin(_Preparation(self._run, work), name=self._run)
            self._check_preparation()
        except BaseException:
            self._client.close()
            raise
        self._threads, self._counted = 1, -_COUNT_AGAIN_S
        self._running: dict[Future[Any], str] = {}
        self._completed = as_completed(loop=self._client.loop)

    @property
    def capacity(self) -> int:
        """Items that may be with the workers at once, of which more may have joined."""
        now = time.monotonic()
        if now > self._counted + _COUNT_AGAIN_S:
            workers = self._client.scheduler_info(n_workers=-1)["workers"].values()
            self._threads = max(1, sum(int(each["nthreads"]) for each in workers))
            self._counted = now
        return AHEAD * self._threads

    def submit(self, key: str, item: Any) -> None:
        """Send an item to any worker."""
        future = self._client.submit(
            _call, self._run, item, key=f"nolens-{uuid4().hex}", pure=False
        )
        self._running[future] = key
        self._completed.add(future)

    def next(self) -> tuple[str, Any]:
        """Wait for an answer.

        Raises
        ------
        FileError
            If the scheduler has gone.
        """
        future = next(self._completed)
        key = self._running.pop(future)
        if future.status == "finished":
            return key, future.result()
        if future.status == "error":
            error = future.exception()
            if isinstance(error, KilledWorker):
                return key, Failure("the worker ended before it had an answer")
            return key, failure(error)
        if self._client.status != "running":
            raise FileError(
                f"the scheduler {self._scheduler} has gone. What was written is kept: run the same "
                "command again when there is one"
            )
        return key, Failure("the worker ended before it had an answer")

    def close(self) -> None:
        """Take back what is under way, and leave the cluster to others."""
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


def _connected(scheduler: str) -> Client:
    """A client of the scheduler at an address, or of the one that a file describes."""
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
        return Client(address, timeout=_SECONDS, set_as_default=False)
    except (OSError, TimeoutError, ValueError, socket.gaierror):
        raise OptionError(
            f"no scheduler answers at {address} within {_SECONDS:g} s: start one (dask scheduler), "
            "or give the address that it prints"
        ) from None


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
        try:
            # Workers that join later are checked here.
            _check_version("this worker", self._version, importlib.metadata.version("nolens"))
            _prepared[self._name] = self._work.prepare()
        except Exception as error:
            _prepared[self._name] = _Refusal(error)

    def teardown(self, worker: Any) -> None:
        """Let go of it."""
        _prepared.pop(self._name, None)


class _Refusal:
    """Stands for work that could not be prepared."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def __call__(self, item: Any) -> Any:
        raise self.error


def _state(run: str) -> Exception | None:
    call = _prepared.get(run)
    return call.error if isinstance(call, _Refusal) else None


def _call(run: str, item: Any) -> Any:
    try:
        return _prepared[run](item)
    except Exception as error:
        return failure(error)
