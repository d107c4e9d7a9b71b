"""The simulated camera, once for all tests of the command."""

from pathlib import Path

import pytest
from little_camera import Camera


@pytest.fixture(scope="session")
def camera(tmp_path_factory: pytest.TempPathFactory) -> Camera:
    return Camera.make(tmp_path_factory.mktemp("camera"))


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Plots are made and not drawn, half a second each: for tests that do not look at them."""
    monkeypatch.setattr("nolens.files.plots._save", lambda figure, path, dpi: Path(path).touch())


@pytest.fixture
def out(tmp_path: Path) -> Path:
    return tmp_path / "out.tif"
