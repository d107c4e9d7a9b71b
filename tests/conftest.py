"""Settings for all tests."""

from collections.abc import Callable, Iterator

import pytest
import torch
from hypothesis import settings

# The first call of a compiled pass takes seconds, and the cores are shared.
settings.register_profile("nolens", deadline=None, derandomize=True, print_blob=True)
settings.load_profile("nolens")


@pytest.fixture
def set_threads() -> Iterator[Callable[[int], None]]:
    """Sets the number of threads, and puts it back after the test."""
    before = torch.get_num_threads()
    yield torch.set_num_threads
    torch.set_num_threads(before)


@pytest.fixture
def one_thread(set_threads: Callable[[int], None]) -> None:
    """For problems so small that threads would only wait for each other."""
    set_threads(1)
