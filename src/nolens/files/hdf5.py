"""Frames in HDF5 (.h5, .hdf5), also as MATLAB writes it (.mat of version 7.3)."""

import math
import zlib
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from nolens.errors import FileError
from nolens.files.arrays import frames_of_array
from nolens.files.axes import Part, matlab_axes
from nolens.files.datasets import MOST_DATASETS, Dataset, choose_dataset
from nolens.files.formats import FrameSequence
from nolens.files.input import check_part, decoding

_KIND = "an HDF5 file"


def open_hdf5(path: Path, dataset: str | None, *, matlab: bool = False) -> FrameSequence:
    """Open a data set of HDF5; that of MATLAB has its axes in the order of MATLAB.

    Raises
    ------
    FileError
        If the file is damaged, it is not clear which data set is meant, or that is coded by a
        filter that is not here or has its values in other files.
    """
    with decoding(path, _KIND), h5py.File(path, "r") as file:
        there = _datasets(file)
        name = choose_dataset(path, there, dataset)
        _check(path, name, file[name])
    shape, dtype = there[name]
    return frames_of_array(
        path,
        shape,
        dtype,
        partial(_part, path, name),
        axes=matlab_axes(shape[::-1])[::-1] if matlab else None,
        dataset=None if dataset is None and len(there) == 1 else name,
    )


def _datasets(file: h5py.File) -> dict[str, Dataset]:
    """Those that are in the file itself: no links are followed."""
    there: dict[str, Dataset] = {}

    def add(name: str, item: Any) -> bool | None:
        # MATLAB keeps texts as numbers, and the contents of cells in a group of its own.
        is_text = isinstance(item, h5py.Dataset) and item.attrs.get("MATLAB_class") == b"char"
        if isinstance(item, h5py.Dataset) and not is_text and not name.startswith("#"):
            there[name] = Dataset(item.shape or (), item.dtype)
        return True if len(there) >= MOST_DATASETS else None

    file.visititems(add)
    return there


def _check(path: Path, name: str, item: h5py.Dataset) -> None:
    if item.external or item.is_virtual:
        raise FileError(
            f"{path}:/{name} has its values in other files, which are not read: copy it whole, "
            "for example by h5repack"
        )
    plan = item.id.get_create_plist()
    for number in range(plan.get_nfilters()):
        code, _, _, label = plan.get_filter(number)
        if not h5py.h5z.filter_avail(code):
            raise FileError(
                f"{path}:/{name} is coded by the filter {label.decode(errors='replace')} (number "
                f"{code}), which is not here: write it again by h5repack -f GZIP=4 IN OUT"
            )
    if item.chunks:
        check_part(math.prod(item.chunks) * item.dtype.itemsize, 0, f"{path}:/{name}")


def _part(path: Path, name: str, part: Part) -> NDArray[Any]:
    with decoding(path, _KIND), h5py.File(path, "r") as file:
        item = file[name]
        if item.compression == "gzip":
            _check_chunks(item, part)
        values: NDArray[Any] = np.asarray(item[part])
        return values


def _check_chunks(item: h5py.Dataset, part: Part) -> None:
    """Refuse chunks that become larger than a chunk is: HDF5 decodes whatever comes."""
    most = math.prod(item.chunks) * item.dtype.itemsize
    slices = tuple(slice(e, e + 1) if isinstance(e, int) else e for e in part)
    for chunk in item.iter_chunks(slices):
        place = tuple(
            each.start - each.start % long for each, long in zip(chunk, item.chunks, strict=True)
        )
        skipped, coded = item.id.read_direct_chunk(place)
        decoder = zlib.decompressobj()
        if not skipped and len(decoder.decompress(coded, most + 1)) > most:
            raise ValueError("a part of it becomes larger than it says")
