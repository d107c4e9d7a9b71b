"""Frames in Zarr stores (versions 2 and 3): folders and .zip, also OME-Zarr."""

import math
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray

from nolens.errors import FileError
from nolens.files.arrays import frames_of_array
from nolens.files.axes import Part
from nolens.files.datasets import Dataset, choose_dataset
from nolens.files.formats import FrameSequence
from nolens.files.input import check_part, decoding

_AXES = {"t": "T", "z": "Z", "c": "C", "y": "Y", "x": "X", "s": "S"}
_KIND = "a Zarr store"


def open_zarr(path: Path, dataset: str | None) -> FrameSequence:
    """Open an array of a Zarr store, in OME-Zarr the finest, by the axes that it names.

    Raises
    ------
    FileError
        If the store is damaged, or it is not clear which array is meant.
    """
    with decoding(path, _KIND):
        root = _root(path)
        if isinstance(root, zarr.Array):
            name, there, axes = "", {"": root}, None
        else:
            there = dict(root.members(max_depth=None))
            there = {key: each for key, each in there.items() if isinstance(each, zarr.Array)}
            finest, axes = _finest(root.attrs.asdict())
            listed = {key: Dataset(each.shape, each.dtype) for key, each in there.items()}
            name = choose_dataset(path, listed, dataset or finest)
        array = there[name]
        named = [
            str(each).lower()
            for each in axes or getattr(array.metadata, "dimension_names", None) or ()
        ]
    if dataset is not None and not name:
        raise FileError(f"{path} is one array: leave :/{dataset} out")
    check_part(math.prod(array.chunks) * array.dtype.itemsize, 0, path)
    known = len(named) == array.ndim and {"y", "x"} <= set(named) <= _AXES.keys()
    return frames_of_array(
        path,
        array.shape,
        array.dtype,
        partial(_part, path, name),
        axes="".join(_AXES[each] for each in named) if known else None,
        dataset=name if len(there) > 1 else None,
    )


def _root(path: Path) -> Any:
    if path.is_dir():
        return zarr.open(path, mode="r")
    return zarr.open(zarr.storage.ZipStore(path, mode="r"), mode="r")


def _finest(attributes: Mapping[str, Any]) -> tuple[str | None, list[str] | None]:
    """Name and axes of the finest array of OME-Zarr; None where it is none.

    https://ngff.openmicroscopy.org/0.5/, multiscales; up to 0.4 they are beside "ome".
    """
    scales = attributes.get("ome", attributes).get("multiscales")
    if not scales:
        return None, None
    axes = [each["name"] if isinstance(each, dict) else each for each in scales[0]["axes"]]
    return scales[0]["datasets"][0]["path"], axes


def _part(path: Path, name: str, part: Part) -> NDArray[Any]:
    with decoding(path, _KIND):
        root = _root(path)
        array = root[name] if name else root
        values: NDArray[Any] = np.asarray(array[part])
        return values
