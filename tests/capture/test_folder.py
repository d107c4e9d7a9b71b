"""A watched folder: which files are handed over, when, and in what order."""

import os
import threading
import time
from pathlib import Path
from threading import Event

import numpy as np
import pytest
import torch

from nolens.capture import FolderSource
from nolens.errors import CameraError, OptionError
from nolens.files import write_dng


def put(path: Path, value: int, at: float | None = None) -> Path:
    """A raw file whose pixels are mostly of one value."""
    counts = torch.full((24, 24), value)
    counts[0, 0] += 1
    write_dng(path, counts, black=64, white=4095, exposure_s=0.02)
    if at is not None:
        os.utime(path, (at, at))
    return path


def value(source: FolderSource) -> int:
    return int(source.shot().frame.counts[0, 9, 9])


@pytest.fixture
def source(tmp_path: Path) -> FolderSource:
    return FolderSource(tmp_path)


def test_only_what_comes_after_it_was_opened_in_the_order_of_time(
    source: FolderSource, tmp_path: Path
) -> None:
    put(tmp_path / "old.dng", 100)
    source.open()
    now = time.time()
    put(tmp_path / "a.dng", 300, now + 2)
    put(tmp_path / "b.dng", 200, now + 1)
    (tmp_path / "notes.txt").write_text("no frame")
    shots = [source.shot() for _ in range(2)]
    assert [int(shot.frame.counts[0, 9, 9]) for shot in shots] == [200, 300]
    assert shots[0].taken.timestamp() == pytest.approx(now + 1, abs=1e-3)
    assert (shots[0].exposure_s, shots[0].frame.mosaic) == (pytest.approx(0.02), "RGGB")
    assert shots[0].details["file"] == str(tmp_path / "b.dng")


def test_files_that_are_there_can_be_taken_first(tmp_path: Path) -> None:
    now = time.time()
    put(tmp_path / "late.dng", 200, now - 1)
    put(tmp_path / "early.dng", 100, now - 2)
    source = FolderSource(tmp_path, existing=True)
    source.open()
    assert [value(source), value(source)] == [100, 200]


def test_a_file_that_grows_is_read_when_it_is_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Time passes only while the folder is waited for; a piece is written each time."""
    whole = put(tmp_path / "whole.dng", 500).read_bytes()
    pieces = [whole[at : at + len(whole) // 8] for at in range(0, len(whole), len(whole) // 8)]

    class Clock(Event):
        now = 0.0

        def monotonic(self) -> float:
            return self.now

        def wait(self, timeout: float | None = None) -> bool:
            assert timeout is not None
            self.now += timeout
            if pieces:
                with (tmp_path / "grows.dng").open("ab") as file:
                    file.write(pieces.pop(0))
            return False

    clock = Clock()
    monkeypatch.setattr("nolens.capture.folder.time", clock)
    monkeypatch.setattr("nolens.capture.folder.Event", lambda: clock)
    source = FolderSource(tmp_path)
    source.open()
    assert value(source) == 500 and pieces == []


def test_the_same_name_again_is_a_new_frame(source: FolderSource, tmp_path: Path) -> None:
    source.open()
    put(tmp_path / "shot.dng", 100)
    first = value(source)
    put(tmp_path / "shot.dng", 200)
    assert (first, value(source)) == (100, 200)


def test_what_cannot_be_read_is_told_and_passed_over(tmp_path: Path) -> None:
    told: list[str] = []
    source = FolderSource(tmp_path, warn=told.append)
    source.open()
    now = time.time()
    broken = tmp_path / "broken.dng"
    broken.write_bytes(b"II*\0 and then nothing of a picture")
    os.utime(broken, (now - 1, now - 1))
    put(tmp_path / "good.dng", 300, now)
    assert value(source) == 300
    assert len(told) == 1 and "broken.dng" in told[0] and "passed over" in told[0]
    put(broken, 400)
    assert value(source) == 400
    assert len(told) == 1


def test_closed_from_another_thread(source: FolderSource) -> None:
    source.open()
    threading.Timer(0.3, source.close).start()
    with pytest.raises(CameraError, match="not watched"):
        source.shot()


def test_settings_and_folders_that_are_none(source: FolderSource, tmp_path: Path) -> None:
    with pytest.raises(OptionError, match="set them at that camera"):
        source.set(exposure_s=0.01, gain=1.0)
    with pytest.raises(CameraError, match="Give a folder that exists"):
        FolderSource(tmp_path / "none").open()
    source.open()
    tmp_path.rename(tmp_path.with_name("moved"))
    with pytest.raises(CameraError, match="cannot watch"):
        source.shot()


def test_npy_with_a_mosaic_that_a_person_says(tmp_path: Path) -> None:
    source = FolderSource(tmp_path, mosaic="GBRG")
    source.open()
    np.save(tmp_path / "x.npy", np.arange(64, dtype=np.uint16).reshape(8, 8))
    assert source.shot().frame.mosaic == "GBRG"
