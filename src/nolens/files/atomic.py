"""Writing files whole or not at all."""

import errno
import os
import secrets
import shutil
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

from nolens.errors import FileError

_LITTLE_BYTES = 1_000_000
_staged: set[Path] = set()
"""Temporary files of `write_together` that wait for the others."""


def write_together(writers: Mapping[Path, Callable[[Path], None]]) -> None:
    """Write several files, all of them or none.

    Parameters
    ----------
    writers
        For each file, what writes it when it is given a path.

    Raises
    ------
    FileError
        If one of them cannot be written; then all stay as they were.
    """
    with ExitStack() as stack:
        for path, write in writers.items():
            temporary = stack.enter_context(atomic_write(path))
            _staged.add(temporary)
            stack.callback(_staged.discard, temporary)
            write(temporary)


@contextmanager
def atomic_write(path: str | Path) -> Iterator[Path]:
    """Give a temporary path beside `path`; what is written there becomes `path` at the end.

    The temporary name starts with a dot and has the same suffix. Where the block raises, the
    temporary file is removed and `path` stays as it was.

    Raises
    ------
    FileError
        If the file cannot be written: no such folder, no permission, disk full.
    """
    path = Path(path)
    if path in _staged:
        yield path
        return
    temporary = path.with_name(f".{path.stem}.{secrets.token_hex(4)}{path.suffix}")
    try:
        yield temporary
        with temporary.open("rb") as written:
            os.fsync(written.fileno())
        temporary.replace(path)
    except OSError as error:
        raise FileError(
            f"cannot write {path}: {_reason(error, path.parent)}. Give a path in a folder that "
            "exists, can be written to and has space"
        ) from error
    finally:
        temporary.unlink(missing_ok=True)


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
    """Raise an error for a path that cannot become a file, before any work is done for it.

    Parameters
    ----------
    path
        The file to be written.
    suffixes
        The suffixes that can be written, such as ``(".png", ".tif")``.

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
