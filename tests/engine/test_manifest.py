"""What a manifest knows after a command that was killed, and what it refuses."""

from functools import partial
from pathlib import Path

import pytest

from nolens.engine import Manifest
from nolens.errors import FileError, OptionError

ABOUT = {"PSF": "a.dng", "version of nolens": "1.0"}
KEYS = ("a", "b", "c", "d")


class KilledError(BaseException):
    """Stands for the end of the process at a point."""


def _die(path: Path) -> None:
    path.write_text("half")
    raise KilledError


def test_nothing_is_lost_or_made_twice(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    (folder / "c.txt").write_text("of another run")
    manifest = Manifest.open(folder, ABOUT, KEYS)
    manifest.keep("a", {"seconds": 1.5}, {folder / "a.txt": lambda path: _write(path, "a")})
    # Killed between its files and the mark.
    real = manifest._set
    monkeypatch.setattr(manifest, "_set", partial(_unless_done, real))
    with pytest.raises(KilledError):
        manifest.keep("b", {"seconds": 2.5}, {folder / "b.txt": lambda path: _write(path, "b")})
    # Killed while it writes.
    with pytest.raises(KilledError):
        manifest.keep("c", {}, {folder / "c.txt": _die})
    manifest.fail("d", "no light", 3)
    with pytest.raises(OptionError, match="another command writes into"):
        Manifest.open(folder, ABOUT, KEYS)
    manifest.close()

    again = Manifest.open(folder, ABOUT, KEYS)
    assert again.missing == ["c", "d"]
    assert {key: row["seconds"] for key, row in again.rows("done").items()} == {"a": 1.5, "b": 2.5}
    assert again.rows("failed") == {"d": {"error": "no light", "attempts": 3}}
    assert not (folder / "c.txt").exists()
    assert again.counts == {"waiting": 1, "writing": 0, "done": 2, "failed": 1}
    again.close()


def test_another_run_is_refused(tmp_path: Path) -> None:
    manifest = Manifest.open(tmp_path, {}, ["z"])  # Of which nothing comes.
    manifest.close()
    manifest = Manifest.open(tmp_path, ABOUT, KEYS)
    manifest.fail("a", "no light", 3)
    manifest.close()
    with pytest.raises(OptionError, match=r"another PSF: a\.dng there, b\.dng now"):
        Manifest.open(tmp_path, {**ABOUT, "PSF": "b.dng"}, KEYS)
    with pytest.raises(OptionError, match="'e' is not among them"):
        Manifest.open(tmp_path, ABOUT, [*KEYS, "e"])
    (tmp_path / "manifest.sqlite").write_text("of something else, and long enough to be read" * 9)
    with pytest.raises(FileError, match="no manifest of nolens"):
        Manifest.open(tmp_path, ABOUT, KEYS)


def _write(path: Path, text: str) -> None:
    path.write_text(text)


def _unless_done(real: object, key: str, state: str, row: str) -> None:
    if state == "done":
        raise KilledError
    real(key, state, row)  # type: ignore[operator]
