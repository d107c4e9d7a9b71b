"""One studio and one browser for all tests of the page: both take seconds to start."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import Visit, chromium, running_studio


@pytest.fixture(scope="session")
def studio_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the studio was started; its workspace is the folder nolens-studio in it."""
    return tmp_path_factory.mktemp("studio")


@pytest.fixture(scope="session")
def studio_address(studio_folder: Path) -> Iterator[str]:
    """Address of a studio that was started without anything else."""
    with running_studio(studio_folder) as address:
        yield address


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """A browser without a screen."""
    with chromium() as browser:
        yield browser


@pytest.fixture
def visit(browser: Any, studio_address: str) -> Iterator[Visit]:
    """A visitor of the page."""
    with Visit(browser, studio_address) as visit:
        visit.begin()
        yield visit
