"""What every test starts from: one thread, known random numbers, a plain shell."""

import gc
import os
import random
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil
import pytest
import torch
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from nolens.process import prepare

if TYPE_CHECKING:
    from distributed import LocalCluster

# The first call of a compiled pass takes seconds, and the cores are shared.
settings.register_profile("nolens", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("nolens")

# Workers inherit this before they load torch: threads that wait sleep, and leave a worker's core to
# the other one.
_SHELL = {
    "LC_ALL": "C.UTF-8", "OMP_NUM_THREADS": "1", "OMP_WAIT_POLICY": "passive", "PYTHONUTF8": "1",
    "TERM": "xterm", "TZ": "UTC",
}  # fmt: skip
_NOT_OURS = (
    "COLUMNS", "LINES", "COLORTERM", "FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE",
    "TTY_INTERACTIVE", "HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY", "http_proxy", "https_proxy",
    "all_proxy",
    "PYTHONDONTWRITEBYTECODE",  # Hundreds of processes would each compile the same sources.
)  # fmt: skip


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--shuffle", type=int, metavar="SEED",
        help="run the modules, and the tests of each, in an order drawn with this seed",
    )  # fmt: skip


def pytest_configure() -> None:
    """A shell without anyone's settings, for this process and those that it starts."""
    prepare()  # As the command does.
    for name in _NOT_OURS:
        os.environ.pop(name, None)
    os.environ.update(_SHELL)
    sys.dont_write_bytecode = False
    time.tzset()
    os.umask(0o022)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # As in a script's background.
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="module")
def cluster() -> Iterator["LocalCluster"]:
    """A Dask cluster with one worker, in this process."""
    from distributed import LocalCluster

    with LocalCluster(
        n_workers=1,
        threads_per_worker=1,
        processes=False,
        protocol="tcp",
        dashboard_address=":0",
    ) as started:
        yield started


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """One for each core that is ours, as far as the memory goes: each grows to 1.6 GB.

    And one more: tests of pages and of what is killed wait for other processes half of the time.
    """
    memory = psutil.virtual_memory().available // 2_500_000_000
    ours = getattr(os, "sched_getaffinity", None)
    cores = len(ours(0)) if ours else os.cpu_count() or 1
    return max(1, min(cores + 1, memory))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    seed = config.getoption("--shuffle")
    if seed is None:
        items.sort(key=lambda item: not _is_of_page(item.path))
        return
    order = random.Random(seed)
    modules: dict[object, list[pytest.Item]] = {}
    for item in items:
        modules.setdefault(item.path, []).append(item)
    shuffled = list(modules.values())
    order.shuffle(shuffled)
    for tests in shuffled:
        order.shuffle(tests)
    items[:] = [item for tests in shuffled for item in tests]


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """The tests stay to the end: no search for garbage goes through them."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


class _ByModule(LoadScopeScheduling):
    """Who is done takes the next module; those of the page are one, and the first.

    They share a studio and a browser, which take seconds to start and work on all the time.
    """

    def _split_scope(self, nodeid: str) -> str:
        module, _, _ = nodeid.partition("::")
        return "page" if _is_of_page(Path(module)) else module


def _is_of_page(module: Path) -> bool:
    return module.name.startswith("test_page_")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> _ByModule:
    config.option.loadscopereorder = False
    return _ByModule(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup() -> None:
    """Before the fixtures: a test that wants threads says so, and draws what it always draws."""
    torch.set_num_threads(1)
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002
    random.seed(0)
