"""Frames in .npz: arrays of NumPy by name."""

import struct
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, Literal, NamedTuple
from zipfile import ZIP_STORED, ZipFile, ZipInfo

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from nolens.files.arrays import frames_of_array
from nolens.files.axes import Part
from nolens.files.datasets import MOST_DATASETS, Dataset, choose_dataset
from nolens.files.formats import FrameSequence
from nolens.files.input import check_size, decoding

_LOCAL_HEADER = 30
"""Bytes of a file's header in a zip archive, before its name (APPNOTE 4.3.7)."""


class _Entry(NamedTuple):
    info: ZipInfo
    dataset: Dataset


def open_npz(path: Path, dataset: str | None) -> FrameSequence:
    """Open an array of an .npz; one that is compressed is decoded whole.

    Raises
    ------
    FileError
        If the file is damaged, or it is not clear which array is meant.
    """
    with decoding(path, "an npz file"):
        there = _entries(path)
    name = choose_dataset(path, {each: entry.dataset for each, entry in there.items()}, dataset)
    info, (shape, dtype) = there[name]
    if info.compress_type == ZIP_STORED:
        take = partial(_part_of_stored, path, info.header_offset)
    else:
        check_size(shape, dtype.itemsize, f"{path}:/{name}")
        take = partial(_part_of_coded, path, info.filename, path.stat().st_mtime_ns)
    return frames_of_array(
        path, shape, dtype, take, dataset=None if dataset is None and len(there) == 1 else name
    )


def _entries(path: Path) -> dict[str, _Entry]:
    entries = {}
    with ZipFile(path) as archive:
        for info in archive.infolist()[:MOST_DATASETS]:
            if info.filename.endswith(".npy"):
                with archive.open(info) as file:
                    shape, _, dtype = _header(file)
                entries[info.filename.removesuffix(".npy")] = _Entry(info, Dataset(shape, dtype))
    return entries


def _header(file: Any) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether columns run faster than rows, and type."""
    read = (
        npy.read_array_header_1_0 if npy.read_magic(file) == (1, 0) else npy.read_array_header_2_0
    )
    header: tuple[tuple[int, ...], bool, np.dtype[Any]] = read(file)
    return header


def _part_of_stored(path: Path, place: int, part: Part) -> NDArray[Any]:
    with decoding(path, "an npz file"), path.open("rb") as file:
        file.seek(place)
        name, extra = struct.unpack("<HH", file.read(_LOCAL_HEADER)[-4:])
        file.seek(name + extra, 1)
        shape, by_columns, dtype = _header(file)
        order: Literal["F", "C"] = "F" if by_columns else "C"
        array: NDArray[Any] = np.memmap(path, dtype, "r", file.tell(), shape, order)
        values: NDArray[Any] = array[part]
        return values


def _part_of_coded(path: Path, name: str, changed: int, part: Part) -> NDArray[Any]:
    with decoding(path, "an npz file"):
        return _whole(path, name, changed)[part]


@lru_cache(maxsize=1)
def _whole(path: Path, name: str, changed: int) -> NDArray[Any]:
    """An array that is decoded; the last one is kept, as its frames are read one after another."""
    with ZipFile(path) as archive, archive.open(name) as file:
        array: NDArray[Any] = npy.read_array(file, allow_pickle=False)
        return array
