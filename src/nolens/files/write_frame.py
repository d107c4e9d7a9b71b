"""Writing the counts of a camera with what is known of them."""

import json
from pathlib import Path

import numpy as np
import tifffile
from torch import Tensor

from nolens.camera import Frame
from nolens.errors import OptionError
from nolens.files.atomic import atomic_write
from nolens.files.tiff_note import SOFTWARE
from nolens.files.write import write_counts
from nolens.files.write_dng import write_dng

FRAME_SUFFIXES = (".dng", ".tif", ".tiff", ".npy")
"""Suffixes of the files that a frame can be written to."""
_LARGEST = 65535


def write_frame(path: str | Path, frame: Frame, *, model: str = "lensless camera") -> None:
    """Write a frame by its suffix, so that `read_frame` gives the same counts again.

    A .dng holds whole counts of a colour mosaic. A .tif holds one channel, whole counts with 16
    bits and others as 32-bit floats; mosaic, black, white and exposure time stand in its
    description. A .npy holds nothing but the counts, (height, width) or (3, height, width).

    Parameters
    ----------
    path
        The file to write.
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
    suffix = path.suffix.lower()
    if suffix == ".npy":
        _write_npy(path, frame.counts)
    elif suffix == ".dng":
        assert frame.mosaic is not None
        write_dng(
            path,
            frame.counts[0],
            pattern=frame.mosaic,
            black=round(black),
            white=_white(frame),
            exposure_s=frame.exposure_s,
            model=model,
        )
    elif _whole(frame.counts):
        write_counts(
            path,
            frame.counts[0],
            mosaic=frame.mosaic,
            black=black,
            white=_white(frame),
            exposure_s=frame.exposure_s,
        )
    else:
        note = {
            "mosaic": frame.mosaic,
            "black": black,
            "white": frame.white,
            "exposure_s": frame.exposure_s,
        }
        with atomic_write(path) as temporary:
            tifffile.imwrite(
                temporary,
                frame.counts[0].numpy(),
                photometric="minisblack",
                description=json.dumps(note),
                metadata=None,
                software=SOFTWARE,
            )


def check_holds(path: Path, frame: Frame) -> None:
    """Refuse a file whose kind cannot hold a frame.

    Raises
    ------
    OptionError
        If that is so; with a kind that can.
    """
    suffix = path.suffix.lower()
    if suffix == ".dng" and frame.mosaic is None:
        raise OptionError(
            f"{path.name} would be a DNG, which holds a colour mosaic, and {frame.source} has "
            f"{', '.join(frame.channels)}: write {path.with_suffix(_other(frame)).name}"
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


def _other(frame: Frame) -> str:
    return ".tif" if len(frame.counts) == 1 else ".npy"


def _write_npy(path: Path, counts: Tensor) -> None:
    values = counts.numpy()
    if _whole(counts):
        values = values.astype(np.uint16)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.save(file, values[0] if len(values) == 1 else values, allow_pickle=False)


def _whole(counts: Tensor) -> bool:
    return bool(((counts == counts.round()) & (counts >= 0) & (counts <= _LARGEST)).all())


def _white(frame: Frame) -> int:
    return _LARGEST if frame.white is None else int(frame.white)
