"""A disk that is really full: a file system of a few megabytes, filled up."""

import shutil
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from serving import NOLENS, serving

from nolens.files import read_frame
from patience import PATIENCE_S

SIZE = 4_000_000


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """An empty disk of `SIZE` bytes."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = shutil.which("mount")
    asked = [str(mount), "-t", "tmpfs", "-o", f"size={SIZE}", "tmpfs", str(folder)]
    if mount is None or subprocess.run(asked, capture_output=True, check=False).returncode:
        pytest.skip("no disk can be mounted here: that takes the rights of root")
    try:
        yield folder
    finally:
        subprocess.run(["umount", "-l", str(folder)], check=True)


def fill(disk: Path, leave: int) -> Path:
    """Leave so many bytes free."""
    ballast = disk / "ballast"
    ballast.write_bytes(bytes(shutil.disk_usage(disk).free - leave))
    return ballast


def test_capture_keeps_the_frames_that_fitted(disk: Path) -> None:
    """A frame of the camera takes 0.17 MB: a dozen of fifty fit."""
    fill(disk, leave=2_000_000)
    done = subprocess.run(
        [NOLENS, "capture", "-o", disk / "night.npy", "--source", "twin:small",
         "--exposure", "1ms", "--frames", "50"],
        capture_output=True, text=True, timeout=PATIENCE_S, check=False,
    )  # fmt: skip
    assert done.returncode == 2, done.stderr
    assert "No space left on device" in done.stderr and "Traceback" not in done.stderr
    kept = sorted(disk.glob("night-*.npy"))
    assert 2 <= len(kept) < 50 and f"the {len(kept)} files" in done.stderr
    for path in kept:
        assert read_frame(path).counts.shape[-2:] == (256, 320)


def test_studio_says_so_and_goes_on_when_there_is_room(disk: Path) -> None:
    work = disk / "work"
    work.mkdir()
    with serving(work, source="twin:small") as studio:
        studio.until("live", lambda live: live["running"])
        random = np.random.default_rng(0).random((64, 80), np.float32)
        np.save(work / "raw.npy", random)
        np.save(work / "psf.npy", (random < 0.01).astype(np.float32))
        options = {
            "measurement": "work/raw.npy",
            "psf": "work/psf.npy",
            "iterations": 4,
            "tau": 1e-4,
        }
        ballast = fill(disk, leave=20_000)

        refused = studio.post("uploads", None, 507, params={"name": "x.dng"}, content=bytes(10**6))
        assert "the disk is full" in refused["detail"]
        refused = studio.post("live/save", {"as": ["raw", "tiff"]}, 422)
        assert "No space left on device" in refused["detail"]
        failed = studio.ended(studio.job("reconstruct", options))
        assert failed["status"] == "failed" and "space" in failed["error"], failed
        assert studio.get("live")["running"]
        with suppress(OSError):
            (disk / "rest").write_bytes(bytes(100_000))
        lost = studio.ended(studio.job("reconstruct", options))
        studio.until(f"jobs/{lost['id']}", lambda job: "is not kept" in str(job["warnings"]))
        (disk / "rest").unlink()
        assert not [each for each in disk.rglob("*") if each.name.startswith(".")]

        ballast.unlink()
        assert studio.post("live/save", {"as": ["raw", "tiff"]})["files"]
        assert studio.ended(studio.job("reconstruct", options))["status"] == "done"
