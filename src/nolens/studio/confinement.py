"""Where a link may lead: a file that lies in a named folder, not out of all of them."""

import os
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

from nolens.errors import FileError


def confine(folders: Sequence[str]) -> None:
    """Refuse to open files through links that lead out of folders, in this process, from now on.

    The server checks every path that a job is given. What a job reads beside it, such as the
    frames of a folder and the files that camera.toml and psfs.toml name, is checked here, where it
    is opened: by every reader, and also by those of libraries.

    Parameters
    ----------
    folders
        Absolute paths without links.
    """
    inside = tuple(f"{folder.rstrip(os.sep)}{os.sep}" for folder in folders)
    # An environment of Python in such a folder has links, to files that are no one's data.
    ours = f"{sys.prefix}{os.sep}"

    def check(event: str, arguments: tuple[object, ...]) -> None:
        if event != "open" or not isinstance(arguments[0], str | bytes | os.PathLike):
            return
        path = os.fsdecode(arguments[0])
        if not path.startswith(inside) or path.startswith(ours):
            return
        reason = leads_out(Path(path), Path(os.path.realpath(path)), folders)
        if reason is not None:
            raise FileError(f"{path} {reason}")

    sys.addaudithook(check)


def leads_out(path: Path, real: Path, folders: Iterable[str | Path]) -> str | None:
    """Why what a path leads to is not to be read; None where it is.

    Parameters
    ----------
    path
        Absolute path of a file.
    real
        It without links.
    folders
        Absolute paths without links, out of all of which it must not lead.
    """
    if real == path:
        return None
    within = next((folder for folder in folders if real.is_relative_to(folder)), None)
    if within is None:
        return "is a link out of its folder, which is not followed"
    if any(part.startswith(".") for part in real.relative_to(within).parts):
        return "is a link to a hidden file, which is not followed"
    return None
