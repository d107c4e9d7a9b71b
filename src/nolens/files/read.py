"""Reading a frame of any accepted format."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from nolens.camera import MOSAICS, Frame
from nolens.errors import FileError, OptionError
from nolens.files.check_input import check_content, check_exists
from nolens.files.limits import check_bytes, check_size
from nolens.files.read_npy import read_npy
from nolens.files.read_png import read_png
from nolens.files.read_raw import RAW_SUFFIXES, read_raw
from nolens.files.read_tiff import read_tiff
from nolens.plugins import load_plugin, plugin_names

_READERS = {".png": read_png, ".tif": read_tiff, ".tiff": read_tiff, ".npy": read_npy}
_READERS |= dict.fromkeys(RAW_SUFFIXES, read_raw)

_CONTENT = {".png": ("PNG",), ".tif": ("TIFF",), ".tiff": ("TIFF",), ".npy": ("npy",)}
_NOT_LINEAR = (".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".heic", ".avif", ".jp2", ".mp4")


def frame_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that can be read, those that other packages add among them."""
    return (*_READERS, *(f".{name}" for name in plugin_names("nolens.readers")))


def read_frame(path: str | Path, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
    """Read the stored counts of a file, and what it says about them.

    Parameters
    ----------
    path
        Camera raw (.dng, .cr2, .nef and others), .tif, .png or .npy; or with a suffix that another
        package adds (entry point ``nolens.readers``, named like the suffix without its dot).
    mosaic
        Says that the single channel of a TIFF, PNG or npy file is a colour mosaic: the colours
        of its 2×2 superpixel row by row, ``"RGGB"``, ``"BGGR"``, ``"GRBG"`` or ``"GBRG"``.
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
        frame = _read_by_plugin(path, suffix)
        if frame is not None:
            return declared(frame, mosaic=mosaic, bgr=bgr)
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_accepted()}")
    check_content(path, _CONTENT.get(suffix, ("TIFF", None)), _accepted())
    return declared(_READERS[suffix](path), mosaic=mosaic, bgr=bgr)


def _read_by_plugin(path: Path, suffix: str) -> Frame | None:
    """Frame by the reader of another package; None where there is none."""
    read: Callable[[Path], Frame] | None = load_plugin("nolens.readers", suffix.removeprefix("."))
    if read is None:
        return None
    check_bytes(path)
    try:
        frame = read(path)
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    except ValueError as error:
        raise FileError(f"{path} cannot be read as {suffix}: {error}") from error
    check_size(frame.counts.shape, frame.counts.element_size(), path)
    return frame


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
        "float .tif, and .npy" + "".join(f", .{name}" for name in plugin_names("nolens.readers"))
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
