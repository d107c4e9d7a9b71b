"""`nolens reproduce`: what it refuses, before anything is computed."""

import shutil
import signal
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from running import check_refused, listing, run, start

from patience import PATIENCE_S, until


def test_the_help_says_what_is_written_and_the_defaults() -> None:
    text = " ".join(run("reproduce", "--help").out.split())
    for words in ("report.html", "timing.json", "--quick", "[default: 0]", "[default: paper]"):
        assert words in text
    assert "reproduce" in run("--help").out


def test_a_folder_is_needed() -> None:
    check_refused(run("reproduce"), "no output is given", "-o FOLDER")


def test_a_folder_that_holds_something_else_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("years of work")
    before = listing(tmp_path)
    done = run("reproduce", "-o", tmp_path, "--quick")
    check_refused(done, "thesis.tex", "no part of a report", "-o")
    assert listing(tmp_path) == before


def test_a_file_is_no_folder(tmp_path: Path) -> None:
    (tmp_path / "report").write_text("")
    check_refused(run("reproduce", "-o", tmp_path / "report"), "is a file", "folder")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--seed", "-1"), ("seed", "-1", "0 to 2147483647")),
        (("--seed", "2.5"), ("2.5", "whole number")),
        (("--seed", "many"), ("many", "whole number")),
        (("--camera", "papr"), ("papr", "paper")),
        (("--quik",), ("--quik",)),
        (("now",), ("now", "reproduce -o FOLDER")),
    ],
)
def test_bad_options_are_refused_and_nothing_is_written(
    tmp_path: Path, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    check_refused(run("reproduce", "-o", tmp_path / "report", *arguments), *words)
    assert list(tmp_path.iterdir()) == []


def test_without_scikit_image_it_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "skimage.data", None)
    done = run("reproduce", "-o", tmp_path / "report")
    check_refused(done, "scikit-image", "pip install 'nolens[demo]'")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda path: SimpleNamespace(free=2_000_000))
    done = run("reproduce", "-o", tmp_path / "deep" / "report", "--camera", "small")
    check_refused(done, "2 MB left", "make room")
    assert list(tmp_path.iterdir()) == []


def test_too_little_memory_is_refused_before_the_work(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("psutil.virtual_memory", lambda: SimpleNamespace(total=5e8))
    check_refused(run("reproduce", "-o", tmp_path / "report"), "GB", "--quick")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_keeps_the_parts_that_are_done(tmp_path: Path) -> None:
    folder = tmp_path / "report"
    with start("reproduce", "-o", folder, "--camera", "small", "--quick") as process:
        until((folder / "steps" / "thickness" / "figures.json").exists, "the first part")
        process.send_signal(signal.SIGINT)
        err = process.communicate(timeout=PATIENCE_S)[1]
    assert process.returncode == 130
    assert "steps" in err and "can be stopped and started again" in err
    found = listing(folder)
    assert "steps/thickness/figures.json" in found
    assert all(name == "steps" or name.startswith("steps/") for name in found)
    assert not any(Path(name).name.startswith(".") for name in found)
