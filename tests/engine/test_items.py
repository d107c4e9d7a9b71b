"""Items through workers: each once, bounded in number, whatever becomes of a worker."""

import asyncio
import importlib.metadata
import sys
from collections import defaultdict
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from itertools import chain
from pathlib import Path

import pytest
from distributed import LocalCluster
from squares import FAILS, KILLS, Squares, Unreadable

from nolens.engine import Outcome, run_items
from nolens.engine.items import AHEAD, ATTEMPTS
from nolens.errors import OptionError
from nolens.process import worker_context

COUNT = 9


def _checked(outcomes: Iterator[Outcome]) -> dict[str, Outcome]:
    """Outcomes by key, where every item has one and all but one are right."""
    found = list(outcomes)
    by_key = {each.key: each for each in found}
    assert len(found) == len(by_key) == COUNT
    for number in range(COUNT):
        each = by_key[str(number)]
        if number == FAILS:
            assert each.error == "ValueError: three is refused"
            assert each.attempts == ATTEMPTS
        else:
            assert each.value == number * number
    return by_key


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere each process loads torch")
def test_where_a_socket_has_no_place_processes_start_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    methods = []
    for folder in ("/tmp", f"/tmp/{'long' * 20}"):
        monkeypatch.setattr("tempfile.tempdir", folder)
        methods.append(worker_context().get_start_method())
    assert methods == ["forkserver", "spawn"]


def test_processes_are_replaced_and_hold_few_items(tmp_path: Path) -> None:
    loaded: list[int] = []

    def load(number: int) -> int:
        loaded.append(number)
        return number

    def watched() -> Iterator[Outcome]:
        items = ((str(number), partial(load, number)) for number in range(COUNT))
        for done, outcome in enumerate(run_items(items, Squares(tmp_path / "killed"), workers=1)):
            assert len({*loaded}) <= done + 1 + AHEAD
            yield outcome

    by_key = _checked(watched())
    assert by_key[str(KILLS)].attempts == 2


@pytest.fixture(scope="module")
def scheduler(cluster: LocalCluster) -> Iterator[str]:
    """Its address; the worker measures itself as before when all commands have left."""
    timers = cluster.workers[0].periodic_callbacks
    before = {name: timers[name].callback_time for name in ("tick", "profile", "profile-cycle")}
    yield cluster.scheduler_address
    assert {name: timers[name].callback_time for name in before} == before
    # Dask would keep 1000 messages to each worker, with what was sent.
    streams = cluster.scheduler.stream_comms.values()
    assert [each.recent_message_log.maxlen for each in streams] == [1]


def test_cluster_gives_the_same(cluster: LocalCluster, scheduler: str) -> None:
    items = ((str(number), partial(int, number)) for number in range(COUNT))
    timer = cluster.workers[0].periodic_callbacks["profile"]
    outcomes = run_items(items, Squares(), scheduler=scheduler)
    first = next(outcomes)
    assert timer.callback_time == 1000
    by_key = _checked(chain((first,), outcomes))
    assert by_key[str(KILLS)].attempts == 1


def test_cluster_from_a_notebook(scheduler: str) -> None:
    async def cell() -> list[Outcome]:
        return list(run_items([("2", partial(int, 2))], Squares(), scheduler=scheduler))

    # Elsewhere than in this thread, where a browser's driver may run a loop, too.
    with ThreadPoolExecutor(1) as notebook:
        (outcome,) = notebook.submit(asyncio.run, cell()).result()
    assert outcome.value == 4


def test_one_item_of_a_task_that_breaks_it(scheduler: str) -> None:
    # The first makes the tasks larger; the task that has the bad one breaks as a whole.
    items = [(str(at), partial(Unreadable if at == KILLS else int, at)) for at in range(COUNT)]
    found = {each.key: each for each in run_items(items, Squares(), scheduler=scheduler)}
    assert "deserialization" in found.pop(str(KILLS)).error
    found.pop(str(FAILS))
    assert {key: each.value for key, each in found.items()} == {key: int(key) ** 2 for key in found}
    assert {each.attempts for each in found.values()} == {1}


def test_workers_of_another_version(scheduler: str, monkeypatch: pytest.MonkeyPatch) -> None:
    here = importlib.metadata.version("nolens")
    versions = iter((here, "0.0.9"))  # The command's, then the worker's.
    monkeypatch.setattr(importlib.metadata, "version", lambda _: next(versions))
    with pytest.raises(OptionError, match=rf"has nolens 0\.0\.9, and the command {here}"):
        list(run_items([("0", int)], Squares(), scheduler=scheduler))


def test_a_worker_that_joins_and_cannot_work(
    scheduler: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    items = ((str(number), partial(int, number)) for number in range(COUNT))
    outcomes = run_items(items, Squares(), scheduler=scheduler)
    next(outcomes)
    prepared = defaultdict(lambda: OptionError("the worker has nolens 0.0.9"))
    monkeypatch.setattr("nolens.engine.cluster._prepared", prepared)
    with pytest.raises(OptionError, match=r"has nolens 0\.0\.9"):
        list(outcomes)
