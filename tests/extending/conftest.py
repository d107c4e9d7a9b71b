"""The command with the example package, and alone."""

from collections.abc import Iterator

import pytest
from plugin_process import INSTALLED, Command


@pytest.fixture(scope="session")
def nolens() -> Iterator[Command]:
    """With the example package."""
    with Command(INSTALLED) as command:
        yield command


@pytest.fixture(scope="session")
def alone() -> Iterator[Command]:
    """Without any."""
    with Command(None) as command:
        yield command
