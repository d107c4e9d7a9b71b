"""What is refused of a file before any library opens it."""

import difflib
import stat
from pathlib import Path

from nolens.errors import FileError

_SIGNATURES = (
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\x93NUMPY", "npy"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"GIF8", "GIF"),
    (b"BM", "BMP"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"II+\0", "TIFF"),
    (b"MM\0+", "TIFF"),
)


def check_exists(path: Path, accepted: str) -> None:
    """Refuse a path that is no file.

    Parameters
    ----------
    path
        The file to be read.
    accepted
        What would be accepted, as a sentence without its full stop.

    Raises
    ------
    FileError
        If there is nothing (with the nearest name in its folder), a folder, or a device.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        message = f"there is no file {path}"
        if not path.parent.is_dir():
            message += f", and no folder {path.parent}"
        else:
            names = [other.name for other in path.parent.iterdir() if other.is_file()]
            near = difflib.get_close_matches(path.name, names, n=1)
            message += f". Did you mean {path.with_name(near[0])}?" if near else " in its folder"
        raise FileError(message) from None
    except (OSError, ValueError) as error:
        raise FileError(f"cannot read {path}: {error}") from error
    if stat.S_ISDIR(mode):
        raise FileError(f"{path} is a folder: give the name of a file in it. {accepted}")
    if not stat.S_ISREG(mode):
        raise FileError(f"{path} is no file but a device or a pipe. {accepted}")


def check_content(path: Path, expected: tuple[str | None, ...], accepted: str) -> None:
    """Refuse a file whose first bytes are not of the kind that its suffix says.

    Parameters
    ----------
    path
        The file to be read.
    expected
        Kinds that the suffix can stand for; None for any that has no known first bytes.
    accepted
        What would be accepted, as a sentence without its full stop.

    Raises
    ------
    FileError
        If it is empty, cannot be read, or is of another kind.
    """
    suffix = path.suffix.lower()
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    if not start:
        raise FileError(f"{path} is empty: copy it again from where it was made")
    found = next((kind for mark, kind in _SIGNATURES if start.startswith(mark)), None)
    if found in expected:
        return
    if found is None:
        raise FileError(
            f"{path} does not hold what its suffix {suffix} says: it is no {expected[0]} file. "
            f"{accepted}"
        )
    raise FileError(
        f"{path} has the suffix {suffix}, but it is a {found} file"
        + (": give it the suffix that fits" if found in ("PNG", "TIFF", "npy") else "")
        + f". {accepted}"
    )
