"""The simulated camera, once for all tests of the command."""

from pathlib import Path

import pytest
from little_camera import Camera


@pytest.fixture(scope="session")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Camera:
    return Camera.make(tmp_path_factory.mktemp("camera"))


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.tif"
