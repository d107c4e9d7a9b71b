"""Reading a frame of any accepted format."""

from dataclasses import replace
from pathlib import Path

from nolens.camera import MOSAICS, Frame
from nolens.errors import FileError, OptionError
from nolens.files.check_input import check_content, check_exists
from nolens.files.read_npy import read_npy
from nolens.files.read_png import read_png
from nolens.files.read_raw import RAW_SUFFIXES, read_raw
from nolens.files.read_tiff import read_tiff

_READERS = {".png": read_png, ".tif": read_tiff, ".tiff": read_tiff, ".npy": read_npy}
_READERS |= dict.fromkeys(RAW_SUFFIXES, read_raw)

SUFFIXES = tuple(_READERS)
"""Suffixes of the files that can be read."""

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
    check_exists(path, _accepted())
    suffix = path.suffix.lower()
    if suffix in _NOT_LINEAR:
        raise FileError(
            f"{path} is a {suffix[1:]} file, whose values are not proportional to light. "
            f"{_accepted()}"
        )
    if suffix not in _READERS:
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_accepted()}")
    check_content(path, _CONTENT.get(suffix, ("TIFF", None)), _accepted())
    return declared(_READERS[suffix](path), mosaic=mosaic, bgr=bgr)


def declared(frame: Frame, *, mosaic: str | None, bgr: bool) -> Frame:
    """Frame with what a person says of it, as `read_frame` takes it.

    Raises
    ------
    OptionError
        If that does not fit the frame.
    """
    if mosaic is not None:
        frame = _declare_mosaic(frame, mosaic)
    if bgr:
        if len(frame.channels) != 3:
            raise OptionError(
                f"{frame.source} has one channel ({frame.channels[0]}), whose order cannot be "
                "B, G, R: leave out --bgr"
            )
        frame = replace(frame, counts=frame.counts.flip(0))
    return frame


def _accepted() -> str:
    return (
        "Accepted are camera raw (.dng, .cr2, .nef and others), 8 or 16-bit .png and .tif, "
        "float .tif, and .npy"
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
