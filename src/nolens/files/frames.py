"""Frames of a camera: files of any accepted format, and what is in them."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.camera import MOSAICS, Frame, Sensor, dark_corner
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError, FileError, OptionError
from nolens.files.atomic import atomic_write
from nolens.files.formats import (
    READERS,
    Address,
    FrameSequence,
    frame_suffixes,
    refuse_dataset,
    several_frames,
    single,
)
from nolens.files.input import (
    RAW_SUFFIXES,
    check_bytes,
    check_content,
    check_exists,
    check_size,
    readable,
    system_errors,
)
from nolens.files.raw import write_dng
from nolens.files.tiff import write_tiff
from nolens.plugins import load_plugin, plugin_names

FRAME_SUFFIXES = (".dng", ".tif", ".tiff", ".npy")
"""Suffixes of the files that a frame can be written to."""

_NOT_LINEAR = (".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".heic", ".avif", ".jp2")
_LARGEST_COUNT = 65535


def read_frame(path: str | Path, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
    """Read the stored counts of a file, and what it says about them.

    Parameters
    ----------
    path
        A file of one of the formats in `READERS`; or with a suffix that another package adds (entry
        point ``nolens.readers``, named like the suffix without its dot). ``take.h5:/raw#3`` is the
        third frame of a data set.
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
    address = Address.of(path)
    frames = open_file(address, mosaic=mosaic, bgr=bgr)
    if address.number is None and len(frames) != 1:
        raise several_frames(address.file, len(frames))
    number = address.number or 1
    if number > len(frames):
        raise FileError(f"{path}: {address.file} has {len(frames)} frames, counted from 1")
    return frames.read(number - 1)


def open_file(address: Address, *, mosaic: str | None = None, bgr: bool = False) -> FrameSequence:
    """Open all frames of one file, or of a data set in it.

    Raises
    ------
    FileError
        As `read_frame` says it.
    OptionError
        If there is no such mosaic.
    """
    path, suffix = address.file, address.file.suffix.lower()
    if mosaic is not None and mosaic not in MOSAICS:
        raise OptionError(f"unknown mosaic {mosaic!r}; accepted are {', '.join(MOSAICS)}")
    reader = READERS.get(suffix)
    if not (reader is not None and reader.is_folder and path.is_dir()):
        check_exists(path, _accepted())
    if suffix in _NOT_LINEAR:
        raise FileError(
            f"{path} is a {suffix[1:]} file, whose values are not proportional to light. "
            f"{_accepted()}"
        )
    if reader is not None:
        if reader.kinds and path.is_file():
            check_content(path, reader.kinds, _accepted())
        found: FrameSequence = resolve_name(reader.opens)(path, address.dataset)
    elif suffix.removeprefix(".") in plugin_names("nolens.readers"):
        refuse_dataset(path, address.dataset)
        found = single(path, _read_by_plugin)
    else:
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_accepted()}")
    if mosaic is None and not bgr:
        return found
    return replace(found, read=partial(_read_declared, found.read, mosaic, bgr))


def _read_by_plugin(path: Path) -> Frame:
    """Frame by the reader of another package."""
    suffix = path.suffix.lower()
    read: Callable[[Path], Frame] = load_plugin("nolens.readers", suffix.removeprefix("."))
    check_bytes(path)
    try:
        with system_errors(path):
            frame = read(path)
    except ValueError as error:
        raise FileError(f"{path} cannot be read as {suffix}: {error}") from error
    check_size(frame.counts.shape, frame.counts.element_size(), path)
    return frame


def _read_declared(
    read: Callable[[int], Frame], mosaic: str | None, bgr: bool, number: int
) -> Frame:
    return _declared(read(number), mosaic=mosaic, bgr=bgr)


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
    others = (each for each in frame_suffixes() if each not in RAW_SUFFIXES)
    return f"Accepted are camera raw (.dng, .cr2, .nef and others), {', '.join(others)}"


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
        "format": Address.of(frame.source).file.suffix.lstrip(".").lower(),
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
        "black": black if frame.black_stated or black else None,
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
