"""Threads of the CPU kernels: torch's number, in a pool of Python's.

The compiled passes let go of Python's lock, so plain threads run them side by side. numba's own
parallel loops are not used: they set the number of threads of the OpenMP runtime that torch
shares, and their threads spin while another program has the core. The pool's threads stay, as what
torch's libraries hold for a thread does.
"""

import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager

import torch

_PIXELS_PER_THREAD = 32768

_BLOCKS_AT_MOST, _PIXELS_PER_BLOCK = 32, 8192

_turn = threading.local()
_pool_lock = threading.Lock()
_pools = dict[int, ThreadPoolExecutor]()
"""By their number of threads; the largest is used."""
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_pools.clear)  # Its threads are not there.


@contextmanager
def one_thread() -> Iterator[int]:
    """One thread for each call, where work is shared by pieces: so many, which is given, are left.

    For a small piece, torch's threads cost more than they bring.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield before
    finally:
        torch.set_num_threads(before)


def threads_for(pixels: int) -> int:
    """Threads that are worth their start for a field of so many pixels, up to torch's number."""
    if getattr(_turn, "taken", False):
        return 1
    return min(torch.get_num_threads(), 1 + pixels // _PIXELS_PER_THREAD)


def for_each_block(work: Callable[[int], None], blocks: int, pixels: int) -> None:
    """Call `work` with every number below `blocks`, on as many threads as `pixels` deserve."""
    threads = threads_for(pixels)
    if threads == 1:
        for block in range(blocks):
            work(block)
        return
    waiting = iter(range(blocks))

    def take() -> None:
        for block in waiting:
            work(block)

    # This thread works too; taking blocks by itself costs less than a pool's queue.
    _side_by_side(take, threads - 1, here=take)


def take_turns(work: Callable[[int, int], None], chains: int, length: int) -> None:
    """Call `work(chain, number)` with every number below `length`, in order for each chain.

    Where there are no more threads than chains, each thread takes the chain that has waited
    longest, and computes with no other thread's help. Else one call follows the other.
    """
    threads = torch.get_num_threads()
    if not 1 < threads <= chains:
        for number in range(length):
            for chain in range(chains):
                work(chain, number)
        return
    waiting = deque((chain, 0) for chain in range(chains) if length > 0)

    broken = threading.Event()

    def take() -> None:
        _turn.taken = True
        try:
            while not broken.is_set() and (turn := _next_of(waiting)) is not None:
                chain, number = turn
                work(chain, number)
                if number + 1 < length:
                    waiting.append((chain, number + 1))
        except BaseException:
            broken.set()  # The others end with what they are at.
            raise
        finally:
            _turn.taken = False

    # Not in this thread, in which torch has threads of its own.
    _side_by_side(take, threads, stop=broken.set)


def _side_by_side(
    work: Callable[[], None],
    threads: int,
    *,
    here: Callable[[], None] = lambda: None,
    stop: Callable[[], None] = lambda: None,
) -> None:
    """Call `work` in so many threads of a pool and something in this one, and wait for all.

    Where this thread is interrupted, the others are told to stop.
    """
    pool = _pool(threads)
    others = [pool.submit(work) for _ in range(threads)]
    try:
        here()
        wait(others)
    except BaseException:
        stop()
        wait(others)
        raise
    for each in others:
        each.result()


def _pool(threads: int) -> ThreadPoolExecutor:
    """At least so many threads, in each of which torch computes with no other's help."""
    with _pool_lock:
        largest = max(_pools, default=0)
        if largest >= threads:
            return _pools[largest]
        ready = threading.Barrier(threads + 1)
        pool = ThreadPoolExecutor(threads, "nolens", _compute_alone)
        for _ in range(threads):
            pool.submit(ready.wait)
        before = torch.get_num_threads()
        ready.wait()
        torch.set_num_threads(before)  # Of threads to come, too.
        _pools[threads] = pool
        return pool


def _compute_alone() -> None:
    """Have torch use one thread in this one."""
    torch.get_num_threads()  # A thread that has not asked takes the number of all when it does.
    torch.set_num_threads(1)


def _next_of(waiting: deque[tuple[int, int]]) -> tuple[int, int] | None:
    try:
        return waiting.popleft()
    except IndexError:  # The others are being worked on.
        return None


def blocks_of(height: int, pixels: int) -> int:
    """Blocks of rows that a pass is cut into: by the size alone, so that no sum depends on the
    threads.
    """
    return min(_BLOCKS_AT_MOST, height, 1 + pixels // _PIXELS_PER_BLOCK)


def block_rows(block: int, blocks: int, height: int) -> tuple[int, int]:
    """First and last + 1 of a block's rows."""
    return block * height // blocks, (block + 1) * height // blocks
