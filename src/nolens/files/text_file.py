"""Text files: descriptions, lists and records."""

import stat
from pathlib import Path

from nolens.documents import LONGEST_JSON
from nolens.errors import FileError


def read_text(path: str | Path, kind: str = "TOML file", advice: str = "") -> str:
    """Read a text file of at most 16 million bytes.

    Parameters
    ----------
    path
        The file; ~ at its beginning stands for the home folder.
    kind
        What it is to be, for messages.
    advice
        What to do where it cannot be read, as a sentence without its full stop.

    Raises
    ------
    FileError
        If there is no such file, or it cannot be read, is longer, or no UTF-8.
    """
    end = f". {advice}" if advice else ""
    try:
        path = Path(path).expanduser()
        # A pipe would wait for ever for somebody to write into it.
        if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
            raise FileError(f"cannot read {path}: it is no file but a device or a pipe{end}")
        with path.open("rb") as file:
            content = file.read(LONGEST_JSON + 1)
    # The names of no user, and characters that no path can have, are no OSError.
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"cannot read {path}: {reason}{end}") from error
    if len(content) > LONGEST_JSON:
        raise FileError(
            f"{path} has more than {LONGEST_JSON // 10**6} million bytes, which no {kind} has{end}"
        )
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is no {kind}: {error}") from error
