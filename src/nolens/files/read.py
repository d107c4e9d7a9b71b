"""Reading a frame of any accepted format."""

import difflib
import stat
from dataclasses import replace
from pathlib import Path

from nolens.camera import MOSAICS, Frame
from nolens.errors import FileError, OptionError
from nolens.files.read_npy import read_npy
from nolens.files.read_png import read_png
from nolens.files.read_raw import RAW_SUFFIXES, read_raw
from nolens.files.read_tiff import read_tiff

_READERS = {".png": read_png, ".tif": read_tiff, ".tiff": read_tiff, ".npy": read_npy}
_READERS |= dict.fromkeys(RAW_SUFFIXES, read_raw)

SUFFIXES = tuple(_READERS)
"""Suffixes of the files that can be read."""

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
_CONTENT = {".png": ("PNG",), ".tif": ("TIFF",), ".tiff": ("TIFF",), ".npy": ("npy",)}
_NOT_LINEAR = (".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".heic", ".avif", ".jp2", ".mp4")


def read_frame(path: str | Path, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
    """Read the stored counts of a file, and what it says about them.

    Parameters
    ----------
    path
        Camera raw (.dng, .cr2, .nef and others), .tif, .png or .npy.
    mosaic
        Says that the single channel of a TIFF, PNG or npy file is a colour mosaic: the colours
        of its 2×2 cell row by row, ``"RGGB"``, ``"BGGR"``, ``"GRBG"`` or ``"GBRG"``.
    bgr
        The three channels are stored in the order B, G, R.

    Raises
    ------
    FileError
        If the file is missing, damaged, of another kind, or holds what cannot be counts.
    OptionError
        If `mosaic` or `bgr` do not fit the file.
    """
    path = Path(path)
    if mosaic is not None and mosaic not in MOSAICS:
        raise OptionError(f"unknown mosaic {mosaic!r}; accepted are {', '.join(MOSAICS)}")
    _check_exists(path)
    suffix = path.suffix.lower()
    if suffix in _NOT_LINEAR:
        raise FileError(
            f"{path} is a {suffix[1:]} file, whose values are not proportional to light. "
            f"{_accepted()}"
        )
    if suffix not in _READERS:
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_accepted()}")
    _check_content(path, suffix)
    frame = _READERS[suffix](path)
    if mosaic is not None:
        frame = _declare_mosaic(frame, mosaic)
    if bgr:
        if len(frame.channels) != 3:
            raise OptionError(
                f"{path} has one channel ({frame.channels[0]}), whose order cannot be B, G, R: "
                "leave out --bgr"
            )
        frame = replace(frame, counts=frame.counts.flip(0))
    return frame


def _accepted() -> str:
    return (
        "Accepted are camera raw (.dng, .cr2, .nef and others), 8 or 16-bit .png and .tif, "
        "float .tif, and .npy"
    )


def _check_exists(path: Path) -> None:
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
        raise FileError(f"{path} is a folder: give the name of a file in it. {_accepted()}")
    if not stat.S_ISREG(mode):
        raise FileError(f"{path} is no file but a device or a pipe. {_accepted()}")


def _check_content(path: Path, suffix: str) -> None:
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    if not start:
        raise FileError(f"{path} is empty: copy it again from where it was made")
    found = next((kind for mark, kind in _SIGNATURES if start.startswith(mark)), None)
    expected = _CONTENT.get(suffix, ("TIFF", None))
    if found in expected:
        return
    if found is None:
        raise FileError(
            f"{path} does not hold what its suffix {suffix} says: it is no {expected[0]} file. "
            f"{_accepted()}"
        )
    raise FileError(
        f"{path} has the suffix {suffix}, but it is a {found} file"
        + (": give it the suffix that fits" if found in ("PNG", "TIFF", "npy") else "")
        + f". {_accepted()}"
    )


def _declare_mosaic(frame: Frame, mosaic: str) -> Frame:
    if frame.mosaic == mosaic:
        return frame
    if frame.mosaic is not None:
        raise OptionError(
            f"{frame.source} says its mosaic is {frame.mosaic}, not {mosaic}: leave out --mosaic"
        )
    if len(frame.channels) != 1:
        raise OptionError(
            f"{frame.source} has the channels {', '.join(frame.channels)}: it is no {mosaic} "
            "mosaic any more. Leave out --mosaic"
        )
    return replace(frame, channels=("mosaic",), mosaic=mosaic)
