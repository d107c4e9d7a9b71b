"""Frames of a camera: files of any accepted format, sequences of them, and what is in them."""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.camera import MOSAICS, Frame, Sensor, dark_corner
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError, FileError, OptionError
from nolens.files.arrays import frame_of_npy, open_npy, read_npy, read_png
from nolens.files.atomic import atomic_write
from nolens.files.input import (
    RAW_SUFFIXES,
    check_bytes,
    check_content,
    check_exists,
    check_size,
    readable,
    system_errors,
)
from nolens.files.raw import read_raw, write_dng
from nolens.files.tiff import count_pages, read_tiff, write_tiff
from nolens.plugins import load_plugin, plugin_names

FRAME_SUFFIXES = (".dng", ".tif", ".tiff", ".npy")
"""Suffixes of the files that a frame can be written to."""

_TIFF_SUFFIXES = (".tif", ".tiff")
_READERS = {".png": read_png, ".tif": read_tiff, ".tiff": read_tiff, ".npy": read_npy}
_READERS |= dict.fromkeys(RAW_SUFFIXES, read_raw)

_CONTENT = {".png": ("PNG",), ".tif": ("TIFF",), ".tiff": ("TIFF",), ".npy": ("npy",)}
_NOT_LINEAR = (".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".heic", ".avif", ".jp2", ".mp4")
_NARROWEST = 16
"""Columns of a frame: a shorter last axis is channels, which one picture has too many of."""
_LARGEST_COUNT = 65535


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
            return _declared(frame, mosaic=mosaic, bgr=bgr)
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_accepted()}")
    check_content(path, _CONTENT.get(suffix, ("TIFF", None)), _accepted())
    return _declared(_READERS[suffix](path), mosaic=mosaic, bgr=bgr)


def _read_by_plugin(path: Path, suffix: str) -> Frame | None:
    """Frame by the reader of another package; None where there is none."""
    read: Callable[[Path], Frame] | None = load_plugin("nolens.readers", suffix.removeprefix("."))
    if read is None:
        return None
    check_bytes(path)
    try:
        with system_errors(path):
            frame = read(path)
    except ValueError as error:
        raise FileError(f"{path} cannot be read as {suffix}: {error}") from error
    check_size(frame.counts.shape, frame.counts.element_size(), path)
    return frame


def _declared(frame: Frame, *, mosaic: str | None, bgr: bool) -> Frame:
    """Frame with what a person says of it, as `read_frame` takes it."""
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


@dataclass(frozen=True)
class FrameSequence:
    """Frames in the order in which they were taken, read one at a time.

    Parameters
    ----------
    names
        One for each frame, for messages and files.
    sources
        The files they are in: one for each frame of a folder, or the stack's.
    read
        Gives a frame by its number, from 0.
    """

    names: tuple[str, ...]
    sources: tuple[Path, ...]
    read: Callable[[int], Frame]


def is_sequence(path: Path) -> bool:
    """Whether a path is a folder, or a file with more than one frame."""
    if path.is_dir():
        return True
    if not path.is_file():
        return False
    suffix = path.suffix.lower()
    if suffix == ".npy":
        shape = open_npy(path).shape
        frames = len(shape) == 3 and not {shape[0], shape[2]} & {1, 3}
        return len(shape) == 4 or (frames and shape[2] >= _NARROWEST)
    return suffix in _TIFF_SUFFIXES and count_pages(path) > 1


def open_sequence(path: Path, *, mosaic: str | None = None, bgr: bool = False) -> FrameSequence:
    """Find the frames of a folder or a stack.

    A folder's frames are its files that `read_frame` knows, sorted by name with numbers in them
    counted as such; other files are passed over. A stack is a TIFF of many pages, or an npy of
    (frames, height, width), (frames, height, width, 1 or 3) or (frames, 1 or 3, height, width).

    Parameters
    ----------
    path
        The folder or file.
    mosaic, bgr
        As `read_frame` takes them.

    Raises
    ------
    FileError
        If there is none, or it holds no frames.
    """
    if path.is_dir():
        return _of_folder(path, mosaic, bgr)
    check_exists(path, "Accepted are a folder of frames, and a .tif or .npy of many")
    suffix = path.suffix.lower()
    if suffix == ".npy":
        stack = open_npy(path)
        count = len(stack)

        def read(number: int) -> Frame:
            return frame_of_npy(stack[number], f"{path}, frame {number + 1}")
    else:
        count = count_pages(path)

        def read(number: int) -> Frame:
            return read_tiff(path, number)

    if count == 0:
        raise FileError(f"{path} holds no frame: give a stack of one or more")
    digits = len(str(count))
    return FrameSequence(
        tuple(f"frame-{number + 1:0{digits}}" for number in range(count)),
        (path,),
        lambda number: _declared(read(number), mosaic=mosaic, bgr=bgr),
    )


def _of_folder(folder: Path, mosaic: str | None, bgr: bool) -> FrameSequence:
    with system_errors(folder):
        files = sorted(
            (
                each
                for each in folder.iterdir()
                if each.suffix.lower() in frame_suffixes() and not each.name.startswith(".")
            ),
            key=lambda each: [
                (int(part), "") if part.isdigit() else (-1, part)
                for part in re.split(r"(\d+)", each.name)
                if part
            ],
        )
    if not files:
        raise FileError(
            f"the folder {folder} holds no frame; its files can be "
            f"{', '.join(sorted(frame_suffixes()))}"
        )
    stems = [each.stem for each in files]
    names = tuple(
        each.stem if stems.count(each.stem) == 1 else each.name.replace(".", "-") for each in files
    )
    return FrameSequence(
        names, tuple(files), lambda number: read_frame(files[number], mosaic=mosaic, bgr=bgr)
    )


def describe(frame: Frame) -> dict[str, Any]:
    """Describe a frame for a person or a program, in values that JSON has.

    Returns
    -------
    dict
        Format, height, width, channels, mosaic, stored type, black, white, exposure in seconds;
        lowest, highest and mean count of each channel or colour of the mosaic; how many values
        are not finite; how many have the highest count (a sensor that saturates below the white
        level shows many); percent saturated; level of the darkest corner. None where unknown.
    """
    usable = frame.counts[torch.isfinite(frame.counts)]
    try:
        corner = dark_corner(frame)
    except DataError:
        corner = math.nan
    return {
        "file": readable(frame.source),
        "format": Path(frame.source).suffix.lstrip(".").lower(),
        "height": frame.counts.shape[-2],
        "width": frame.counts.shape[-1],
        "channels": list(frame.channels),
        "mosaic": frame.mosaic,
        "stored_as": frame.stored_as,
        "black": list(frame.black),
        "white": frame.white,
        "exposure_s": frame.exposure_s,
        "counts": {name: _count_range(values) for name, values in _colours(frame).items()},
        "not_finite": frame.counts.numel() - usable.numel(),
        "at_highest": int((usable == usable.max()).sum()) if usable.numel() else 0,
        "saturated_percent": (
            None
            if frame.white is None
            else 100 * float((frame.counts >= frame.white).double().mean())
        ),
        "dark_corner": corner if math.isfinite(corner) else None,
    }


def _colours(frame: Frame) -> dict[str, Tensor]:
    """Counts of each channel, or of each colour of the mosaic."""
    if frame.mosaic is None:
        return dict(zip(frame.channels, frame.counts, strict=True))
    colours = colour_planes(frame.counts, frame.mosaic)
    return {name: torch.cat([p.flatten() for p in planes]) for name, planes in colours.items()}


def _count_range(values: Tensor) -> dict[str, float] | None:
    usable = values[torch.isfinite(values)]
    if not usable.numel():
        return None
    return {
        "min": float(usable.min()),
        "max": float(usable.max()),
        "mean": float(usable.double().mean()),
    }


def write_frame(path: str | Path, frame: Frame, *, model: str = "lensless camera") -> None:
    """Write a frame by its suffix, so that `read_frame` gives the same counts again.

    A .dng holds whole counts of a colour mosaic. A .tif holds one channel, whole counts with 16
    bits and others as 32-bit floats; mosaic, black, white and exposure time stand in its
    description. A .npy holds nothing but the counts, (height, width) or (3, height, width).

    Parameters
    ----------
    frame
        Its black level is written as one number, the mean of those of a superpixel's pixels.
    model
        Name of the camera, ASCII, for a .dng.

    Raises
    ------
    OptionError
        If the file's kind cannot hold such a frame.
    FileError
        If the file cannot be written.
    """
    path = Path(path)
    check_holds(path, frame)
    black = sum(frame.black) / len(frame.black)
    white = _LARGEST_COUNT if frame.white is None else int(frame.white)
    whole = _whole(frame.counts)
    suffix = path.suffix.lower()
    if suffix == ".dng":
        assert frame.mosaic is not None
        write_dng(
            path,
            frame.counts[0],
            pattern=frame.mosaic,
            black=round(black),
            white=white,
            exposure_s=frame.exposure_s,
            model=model,
        )
        return
    values = frame.counts.numpy()
    if whole:
        values = values.astype(np.uint16)
    if len(values) == 1:
        values = values[0]
    if suffix == ".npy":
        with atomic_write(path) as temporary, temporary.open("wb") as file:
            np.save(file, values, allow_pickle=False)
        return
    note = {
        "mosaic": frame.mosaic,
        "black": black,
        "white": white if whole else frame.white,
        "exposure_s": frame.exposure_s,
    }
    write_tiff(path, values, note)


def check_holds(path: Path, frame: Frame) -> None:
    """Refuse a file whose kind cannot hold a frame.

    Raises
    ------
    OptionError
        If that is so; with a kind that can.
    """
    suffix = path.suffix.lower()
    if suffix == ".dng" and frame.mosaic is None:
        other = path.with_suffix(".tif" if len(frame.counts) == 1 else ".npy")
        raise OptionError(
            f"{path.name} would be a DNG, which holds a colour mosaic, and {frame.source} has "
            f"{', '.join(frame.channels)}: write {other.name}"
        )
    if suffix == ".dng" and not _whole(frame.counts):
        raise OptionError(
            f"{path.name} would be a DNG, which holds whole counts, and an average has fractions: "
            f"write {path.with_suffix('.tif').name}"
        )
    if suffix in (".tif", ".tiff") and len(frame.counts) > 1:
        raise OptionError(
            f"{path.name} would be a TIFF of one channel, and {frame.source} has "
            f"{', '.join(frame.channels)}: write {path.with_suffix('.npy').name}"
        )


def check_holds_sensor(path: Path, sensor: Sensor) -> None:
    """Refuse a DNG of a sensor without a colour mosaic or a whole black level.

    Raises
    ------
    OptionError
        If that is so; with a kind of file that can hold its counts.
    """
    if path.suffix.lower() != ".dng":
        return
    if sensor.mosaic == "none":
        raise OptionError(
            f"{path.name} would be a DNG, which holds a colour mosaic, and the sensor "
            f"{sensor.name!r} has none: write {path.with_suffix('.tif').name}"
        )
    if not sensor.black_counts.is_integer():
        raise OptionError(
            f"{path.name} would be a DNG with a whole black level, and the sensor {sensor.name!r} "
            f"has {sensor.black_counts:g}: write {path.with_suffix('.tif').name}, or round it"
        )


def _whole(counts: Tensor) -> bool:
    return bool(((counts == counts.round()) & (counts >= 0) & (counts <= _LARGEST_COUNT)).all())
