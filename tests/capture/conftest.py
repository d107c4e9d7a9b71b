"""Settings for the tests of cameras."""

import pytest


@pytest.fixture(autouse=True)
def _one_thread(one_thread: None) -> None:
    """Frames of a few hundred pixels: threads would only wait for each other."""
