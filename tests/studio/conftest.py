"""One studio and one browser for all tests of the page: both take seconds to start."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from browser import SHOWN, Visit, await_text, chromium, running_studio


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


@pytest.fixture(scope="session")
def shot(browser: Any, studio_address: str) -> str:
    """Name of a raw frame that the viewfinder saved; the PSF of the twin comes with it."""
    with Visit(browser, studio_address) as visit:
        visit.begin()
        page = visit.show("viewfinder")
        await_text(page, ".view figcaption", "twin of live")
        if not SHOWN:
            # A smaller camera takes the same way in less time.
            assert visit.tell("live/start", {"source": "twin:small"}).ok
            await_text(page, ".view figcaption", "twin of small")
        await_text(page, ".verdict", "Exposure right")
        page.keyboard.press("s")
        await_text(page, "[role=status]", "Saved in")
        names = page.locator(".files a").all_text_contents()
        visit.tell("live/start", {"source": "twin:live"})
        return next(name for name in names if name.endswith(".dng"))
