"""Frames in .mat: arrays of MATLAB, of versions 4 to 7.3."""

import struct
import zlib
from functools import lru_cache, partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.io import loadmat, whosmat

from nolens.files.arrays import frames_of_array
from nolens.files.axes import Part, matlab_axes
from nolens.files.datasets import Dataset, choose_dataset
from nolens.files.formats import FrameSequence
from nolens.files.hdf5 import open_hdf5
from nolens.files.input import check_bytes, check_size, decoding

_HEADER = 128
_VERSION_5, _VERSION_7_3 = b"MATLAB 5.0", b"MATLAB 7.3"
_COMPRESSED = 15
_TYPES = {"double": np.float64, "single": np.float32, "uint8": np.uint8, "uint16": np.uint16}


def open_mat(path: Path, dataset: str | None) -> FrameSequence:
    """Open an array of a .mat: rows, columns, colours, frames.

    One of version 7.3 is HDF5, of which a frame is read at a time. Others are decoded whole.

    Raises
    ------
    FileError
        If the file is damaged, or it is not clear which array is meant.
    """
    with path.open("rb") as file:
        start = file.read(len(_VERSION_5))
    if start == _VERSION_7_3:
        return open_hdf5(path, dataset, matlab=True)
    changed = path.stat().st_mtime_ns
    with decoding(path, "a .mat file"):
        there = {
            name: Dataset(tuple(shape), np.dtype(_TYPES.get(kind, object)))
            for name, shape, kind in whosmat(BytesIO(_plain(path, changed)))
        }
    name = choose_dataset(path, there, dataset)
    shape, dtype = there[name]
    check_size(shape, dtype.itemsize, f"{path}:/{name}")
    return frames_of_array(
        path,
        shape,
        dtype,
        partial(_part, path, name, changed),
        axes=matlab_axes(shape),
        dataset=None if dataset is None and len(there) == 1 else name,
    )


@lru_cache(maxsize=1)
def _plain(path: Path, changed: int) -> bytes:
    """The file without compression, each of its variables no longer than it says.

    MAT-File Format, R2023a, chapter 1: a header, and elements of type, length and contents.
    """
    check_bytes(path)
    data = path.read_bytes()
    if not data.startswith(_VERSION_5):
        return data
    order = "<" if data[126:128] == b"IM" else ">"
    parts, place = [data[:_HEADER]], _HEADER
    while place + 8 <= len(data):
        kind, length = struct.unpack_from(f"{order}II", data, place)
        part = data[place : place + 8 + length]
        if kind == _COMPRESSED:
            decoder = zlib.decompressobj()
            tag = decoder.decompress(part[8:], 8)
            (inside,) = struct.unpack_from(f"{order}I", tag, 4)
            check_size((sum(map(len, parts)) + inside,), 1, path)
            part = tag + decoder.decompress(decoder.unconsumed_tail, inside or 1)
        parts.append(part)
        place += 8 + length
    return b"".join(parts)


def _part(path: Path, name: str, changed: int, part: Part) -> NDArray[Any]:
    with decoding(path, "a .mat file"):
        return _array(path, name, changed)[part]


@lru_cache(maxsize=1)
def _array(path: Path, name: str, changed: int) -> NDArray[Any]:
    """An array; the last one is kept, as its frames are read one after another."""
    array: NDArray[Any] = loadmat(BytesIO(_plain(path, changed)), variable_names=[name])[name]
    return array
