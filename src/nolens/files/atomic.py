"""Writing files, and folders with files, whole or not at all."""

import errno
import itertools
import os
import re
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil

from nolens.errors import FileError
from nolens.interrupt import Unfinished, Uninterrupted

Writer = Callable[[Path], object]
"""What writes a file when it is given a path."""

_LITTLE_BYTES = 1_000_000
_OURS = re.compile(r"\.nolens-(\d{1,10})-[0-9a-f]{8}(\.\w+)?")
_staged: set[Path] = set()
"""Temporary files that wait to take their places."""
_swept: set[Path] = set()
"""Folders that were freed of what killed processes left."""


def write_together(writers: Mapping[Path, Writer]) -> None:
    """Write several files, all of them or none; for each, what writes it when it is given a path.

    Raises
    ------
    FileError
        If one of them cannot be written; then all stay as they were.
    """
    with _staging(tuple(writers)) as temporaries:
        for path, write in writers.items():
            with _naming(path):
                write(temporaries[path])


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; what is written there becomes `path` at the end.

    The temporary name starts with a dot and has the same suffix. Where the block raises, or
    Ctrl-C ends the command, the temporary file is removed and `path` stays as it was. What a
    killed process left is removed by the next one that writes into the folder.

    Raises
    ------
    FileError
        If the file cannot be written: no such folder, no permission, disk full.
    """
    path = Path(path)
    if path in _staged:
        yield path
        return
    with _staging((path,)) as temporaries, _naming(path):
        yield temporaries[path]


@contextmanager
def _staging(paths: tuple[Path, ...]) -> Iterator[dict[Path, Path]]:
    """Temporary paths for some files; at the end of the block they become them, together."""
    temporaries = {path: _temporary(path) for path in paths}
    for folder in {path.parent for path in paths} - _swept:
        _sweep(folder)
    _staged.update(temporaries.values())
    try:
        with Unfinished(*temporaries.values()):
            yield temporaries
            for path, temporary in temporaries.items():
                with _naming(path), temporary.open("rb") as written:
                    os.fsync(written.fileno())
            with Uninterrupted():
                for path, temporary in temporaries.items():
                    with _naming(path):
                        temporary.replace(path)
    finally:
        _staged.difference_update(temporaries.values())
        for temporary in temporaries.values():
            temporary.unlink(missing_ok=True)


def _temporary(path: Path) -> Path:
    """A name that says whose it is."""
    return path.with_name(f".nolens-{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")


def _sweep(folder: Path) -> None:
    """Remove temporary files of processes that are no more, once in the life of this one."""
    _swept.add(folder)
    used = {each.name for each in _staged}
    with suppress(OSError):
        for path in folder.iterdir():
            match = _OURS.fullmatch(path.name)
            if match is None or path.name in used:
                continue
            # The number may have become this process's own.
            if int(match[1]) == os.getpid() or not psutil.pid_exists(int(match[1])):
                path.unlink()


@contextmanager
def _naming(path: Path) -> Iterator[None]:
    """Errors of the system as ours, which say what file could not be written."""
    try:
        yield
    except OSError as error:
        raise FileError(
            f"cannot write {path}: {_reason(error, path.parent)}. Give a path in a folder that "
            "exists, can be written to and has space"
        ) from error


def _reason(error: OSError, folder: Path) -> str:
    """What the system says, or what it would have said."""
    if error.strerror:
        return error.strerror
    # numpy says how much of an array was written, and not why no more.
    with suppress(OSError):
        if shutil.disk_usage(folder).free < _LITTLE_BYTES:
            return f"{os.strerror(errno.ENOSPC)} ({error})"
    return str(error)


def check_output(path: str | Path, suffixes: Collection[str]) -> None:
    """Refuse a path that cannot become a file, before any work is done for it.

    The suffixes are those that can be written, such as ``(".png", ".tif")``.

    Raises
    ------
    FileError
        If the suffix is another one, the path is a folder, or its folder is missing or cannot
        be written to.
    """
    path = Path(path)
    accepted = ", ".join(suffixes)
    if path.is_dir():
        raise FileError(f"{path} is a folder: give the name of a file in it ({accepted})")
    if path.suffix.lower() not in suffixes:
        raise FileError(
            f"cannot write {path}: the suffix {path.suffix or '(none)'} is not known here. "
            f"Accepted: {accepted}"
        )
    folder = path.parent
    if not folder.exists():
        raise FileError(f"cannot write {path}: there is no folder {folder}. Make it first")
    if not folder.is_dir():
        raise FileError(f"cannot write {path}: {folder} is a file, not a folder")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise FileError(
            f"cannot write {path}: no permission to write in {folder}. Give another folder"
        )


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be made or written to, before any work is done for it.

    Raises
    ------
    FileError
        If it is a file, or it or the one it would be made in cannot be written to.
    """
    there = next((each for each in (folder, *folder.parents) if os.path.lexists(each)), Path())
    if not there.is_dir():
        raise FileError(f"{there} is a file: give the name of a folder (-o)")
    if not os.access(there, os.W_OK | os.X_OK):
        raise FileError(
            f"cannot write {folder}: no permission to write in {there}. Give another folder (-o)"
        )


def write_into(folder: Path, writers: Mapping[Path, Writer]) -> None:
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
        for above in itertools.takewhile(lambda at: not os.path.lexists(at), (each, *each.parents))
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


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 with the ends of lines that the text has, on any system."""
    path.write_text(text, encoding="utf-8", newline="\n")
