"""What a process of ours asks of Python and of the C library, for itself alone."""

import ctypes
import gc
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from multiprocessing.context import ForkServerContext, SpawnContext

_OBJECTS_BETWEEN_SEARCHES = 50_000
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
_LARGE_BYTES, _MOST_BYTES = 2**26, 2**31 - 1
_LONGEST_PATH = 64
"""Characters; a socket's has 108 at most, and multiprocessing adds some thirty."""


def prepare() -> None:
    """Spare the process work that it does not need; called before anything is loaded.

    Loading torch makes some hundred thousand objects that stay, and looking for garbage among them
    takes a quarter of a second. glibc hands freed memory back to the system and takes it anew,
    page by page and zeroed: that was a fifth of a draft's time, and a third of a photo's where
    light may come from everywhere at the paper's size. Here it is kept for the next array, if
    that has 64 MiB at most. Holes between arrays are a few per cent more memory for such a photo,
    as `__main__` sees to it that the next one fits. torch's arrays have large pages, where the
    system gives those to who asks.
    OpenMP's threads spin while they wait for each other, and keep the core from the one that they
    wait for: beside other programs, a picture then takes up to ten times as long. Some microseconds
    of it cost nothing there, and spare most of the time that threads take to wake.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("GOMP_SPINCOUNT", "2000")
    os.environ.setdefault("THP_MEM_ALLOC_ENABLE", "1")
    gc.set_threshold(_OBJECTS_BETWEEN_SEARCHES)
    with suppress(AttributeError, OSError, TypeError):  # Another C library.
        mallopt = ctypes.CDLL(None).mallopt
        mallopt(_MMAP_THRESHOLD, _LARGE_BYTES)
        mallopt(_TRIM_THRESHOLD, _MOST_BYTES)


def release_memory() -> None:
    """Hand freed memory back to the system, before arrays of another size than those so far.

    They do not fit into the holes that are kept (`prepare`).
    """
    with suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def leave() -> None:
    """Let the process end without a last search for garbage, which takes a third of a second."""
    gc.freeze()


def worker_context(*modules: str) -> "ForkServerContext | SpawnContext":
    """How processes beside this one start.

    On Linux they are copies of one that has loaded modules before the first: a process then starts
    in a tenth of a second, and what they have loaded is in memory once. Threads of torch and a CUDA
    context would not be copied with it: no module computes anything while it is loaded. Elsewhere
    each loads its own, and where the path of temporary files is too long for a socket's.

    Parameters
    ----------
    modules
        What most of them load; those of the first call count.
    """
    import tempfile  # Both take a while, which every start of the command would wait.
    from multiprocessing import get_context

    if sys.platform != "linux" or len(tempfile.gettempdir()) > _LONGEST_PATH:
        return get_context("spawn")
    context = get_context("forkserver")
    context.set_forkserver_preload(list(modules))
    return context


@contextmanager
def without_ctrl_c() -> Iterator[None]:
    """What is started here never sees the terminal's Ctrl-C: its parent ends it."""
    block = getattr(signal, "pthread_sigmask", None)
    if block is None:  # Windows
        yield
        return
    before = block(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        block(signal.SIG_SETMASK, before)
