"""Writing into a folder that may not exist yet."""

import itertools
import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

from nolens.errors import FileError
from nolens.files.atomic import write_together
from nolens.interrupt import Unfinished


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written to, before any work is done for it.

    Raises
    ------
    FileError
        If it is a file, or it or the one it would be made in cannot be written to.
    """
    there = _existing(folder)
    if not there.is_dir():
        raise FileError(f"{there} is a file: give the name of a folder (-o)")
    if not os.access(there, os.W_OK | os.X_OK):
        raise FileError(
            f"cannot write {folder}: no permission to write in {there}. Give another folder (-o)"
        )


def write_into(folder: Path, writers: Mapping[Path, Callable[[Path], None]]) -> None:
    """Write several files, all of them or none, and make their folder for them.

    Parameters
    ----------
    folder
        Made where it does not exist, with those above it; taken away again if a file fails.
    writers
        As in `write_together`; folders of theirs in that one are made too.

    Raises
    ------
    FileError
        If the folder cannot be made or a file not be written.
    """
    folders = {folder, *(path.parent for path in writers)}
    missing = {
        above
        for each in folders
        for above in itertools.takewhile(lambda at: not _exists(at), (each, *each.parents))
    }
    new = sorted(missing, key=lambda at: len(at.parts))
    with Unfinished(*new):
        try:
            try:
                for each in folders:
                    each.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise FileError(
                    f"cannot make {error.filename}: {error.strerror or error}"
                ) from error
            write_together(writers)
        except BaseException:
            for each in reversed(new):
                with suppress(OSError):
                    each.rmdir()
            raise


def _existing(folder: Path) -> Path:
    """The folder, or the nearest one above it that exists."""
    for each in (folder, *folder.parents):
        if _exists(each):
            return each
    return Path()


def _exists(path: Path) -> bool:
    return os.path.lexists(path)
