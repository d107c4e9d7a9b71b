"""Frames of arrays, and the formats that hold nothing else: npy and PNG."""

import struct
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import imagecodecs
import numpy as np
import torch
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.axes import Layout, Part
from nolens.files.formats import FrameSequence, refuse_dataset, several_frames, single
from nolens.files.input import check_bytes, check_size, decoding, quiet_stderr

_CHANNELS = {1: ("grey",), 3: ("R", "G", "B")}
STORED = {"uint8": 255.0, "uint16": 65535.0, "float16": None, "float32": None, "float64": None}
"""Types that frames are stored as, and the count from which a pixel is saturated."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 2, 6: 4}
"""By colour type; a palette may have alpha."""
_PNG_PALETTE = 3


def frame_from_array(array: NDArray[np.generic], source: str) -> Frame:
    """A frame of an array (channels, height, width) of 8/16-bit counts or floats.

    Raises
    ------
    FileError
        If its type is another one, or it does not have one or three channels.
    """
    stored_as = array.dtype.name
    if stored_as not in STORED:
        raise FileError(
            f"{source} holds {stored_as}; accepted are {', '.join(STORED)}. Convert it, "
            'for example with numpy: array.astype("float32")'
        )
    if array.ndim != 3 or array.shape[0] not in _CHANNELS or 0 in array.shape:
        raise FileError(
            f"{source} has (channels, height, width) {array.shape}; accepted are one channel "
            "(grey or a colour mosaic) or three (R, G, B)"
        )
    with np.errstate(over="ignore"):
        counts = torch.from_numpy(np.require(array, np.float32, ["C", "W"]))
    return Frame(
        counts=counts,
        channels=_CHANNELS[array.shape[0]],
        mosaic=None,
        black=(0.0,),
        white=STORED[stored_as],
        stored_as=stored_as,
        source=source,
    )


def open_npy(path: Path, dataset: str | None) -> FrameSequence:
    """Open H×W or H×W×C or C×H×W (C of 1 or 3), or many of them, of counts or floats.

    Raises
    ------
    FileError
        If the file is damaged or holds something else.
    """
    refuse_dataset(path, dataset)
    array = _map(path)
    return frames_of_array(path, array.shape, array.dtype, partial(_part_of_npy, path))


def read_npy_numbers(path: Path) -> NDArray[Any]:
    """Read one frame of numbers of any type, (channels, height, width): of a map, not of light.

    Raises
    ------
    FileError
        If the file is damaged or too large, or its shape is not that of one frame.
    """
    array = _map(path)
    layout = Layout.of(array.shape, str(path), None)
    check_size(layout.frame_shape, array.dtype.itemsize, path)
    if len(layout.names) != 1:
        raise several_frames(path, len(layout.names))
    return layout.channels_first(array[layout.part(0)])


def _part_of_npy(path: Path, part: Part) -> NDArray[Any]:
    return _map(path)[part]


def _map(path: Path) -> NDArray[Any]:
    """Map an npy file into memory."""
    try:
        # A map of the file is refused where the file is shorter than its header says.
        with np.errstate(all="ignore"):
            array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    # The header is text that numpy evaluates: damage can raise nearly anything. What numpy says
    # of it is advice to load it nevertheless.
    except Exception as error:
        raise FileError(
            f"{path} cannot be read as an npy file: it is damaged, incomplete, or holds objects "
            "instead of numbers. Write it again with numpy.save"
        ) from error
    return array


def frames_of_array(
    path: Path,
    shape: Sequence[int],
    dtype: np.dtype[Any],
    take: Callable[[Part], NDArray[Any]],
    *,
    axes: str | None = None,
    dataset: str | None = None,
) -> FrameSequence:
    """Frames of an array in a file, of which a part is read at a time.

    Parameters
    ----------
    path
        The file.
    shape, dtype
        Of the array.
    take
        Reads a part of it.
    axes
        A letter for each axis, where the file says what they are: Y, X, C or S for channels, and
        others for frames. None finds them by the shape.
    dataset
        Its name in the file, where that has several.

    Raises
    ------
    FileError
        If one frame is too large, or the shape or the kind of numbers is not that of frames.
    """
    source = str(path) if dataset is None else f"{path}:/{dataset}"
    layout = Layout.of(tuple(shape), source, axes)
    check_size(layout.frame_shape, dtype.itemsize, source)
    return FrameSequence(layout.names, (path,), partial(_frame_of_part, layout, take, source))


def _frame_of_part(
    layout: Layout, take: Callable[[Part], NDArray[Any]], source: str, number: int
) -> Frame:
    if len(layout.names) > 1:
        source += f"#{number + 1}"
    return frame_from_array(layout.channels_first(take(layout.part(number))), source)


def open_png(path: Path, dataset: str | None) -> FrameSequence:
    """Open grey, colour or palette PNG.

    Raises
    ------
    FileError
        If a data set is named, which it has none of.
    """
    refuse_dataset(path, dataset)
    return single(path, read_png)


def read_png(path: Path) -> Frame:
    """Read grey, colour or palette PNG; an alpha channel is dropped.

    Raises
    ------
    FileError
        If the file is damaged, too large, or has fewer than 8 bits.
    """
    return frame_of_samples(read_png_samples(path), str(path))


def frame_of_samples(samples: NDArray[np.generic], source: str) -> Frame:
    """A frame of (height, width, 1 to 4) of grey or colour; alpha is dropped."""
    colours = 3 if samples.shape[-1] >= 3 else 1
    return frame_from_array(np.moveaxis(samples[..., :colours], -1, 0), source)


def read_png_samples(path: Path) -> NDArray[np.generic]:
    """Read (height, width, 1 to 4) of grey or colour, and alpha where there is one.

    Raises
    ------
    FileError
        If the file is damaged, too large, or has fewer than 8 bits.
    """
    check_bytes(path)
    with decoding(path, "a PNG"):
        data = path.read_bytes()
    return decode_png(data, path)


def decode_png(data: bytes, path: Path) -> NDArray[np.generic]:
    """As `read_png_samples`, of the contents of a file; messages name the path."""
    with decoding(path, "a PNG"):
        header = _png_header(data)
        if header.bits < 8 and header.colour != _PNG_PALETTE:
            raise FileError(f"{path} is a PNG of {header.bits} bits: it needs 8 or 16")
        shape = (header.height, header.width, _PNG_CHANNELS[header.colour])
        check_size(shape, header.bits // 8, path)
        # libpng remarks on interlaced pictures, which it reads.
        with quiet_stderr():
            array: NDArray[np.generic] = imagecodecs.png_decode(data)
    return array[..., None] if array.ndim == 2 else array


class _PngHeader(NamedTuple):
    width: int
    height: int
    bits: int
    colour: int


def _png_header(data: bytes) -> _PngHeader:
    """First chunk of a file that has its last one: libpng does not miss that."""
    if not data.startswith(_PNG_SIGNATURE + b"\0\0\0\x0dIHDR"):
        raise ValueError("it has no header")
    start = len(_PNG_SIGNATURE)
    while (chunk := data[start : start + 8])[4:] != b"IEND":
        if len(chunk) < 8:
            raise ValueError("its end is missing")
        start += 12 + struct.unpack(">I4s", chunk)[0]
    if start + 12 > len(data):
        raise ValueError("its end is missing")
    return _PngHeader(*struct.unpack(">IIBB", data[16:26]))
