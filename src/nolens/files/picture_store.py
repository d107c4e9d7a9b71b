"""Pictures of many frames in one Zarr store, with the axes and units of OME-Zarr 0.5.

The array ``0`` has (frame, channel, row, column), one chunk for each frame, so that frames can be
written in any order and by their own; `encoded_picture` gives the chunk's bytes anywhere.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numpy.typing import NDArray
from zarr.storage import MemoryStore

from nolens.errors import FileError
from nolens.files.input import readable, system_errors

_LEVEL, _VERSION = "0", "0.5"
_AXES = ("t", "c", "y", "x")


def encoded_picture(picture: NDArray[np.float32]) -> bytes:
    """The chunk of a picture, (channels, height, width)."""
    chunks: dict[str, Any] = {}
    array = _create(MemoryStore(chunks), 1, picture.shape)
    array[0] = picture
    return bytes(chunks[f"{_LEVEL}/c/0/0/0/0"].to_bytes())


def chunk_path(store: Path, number: int) -> Path:
    """File of a frame's chunk."""
    return store / _LEVEL / "c" / str(number) / "0" / "0" / "0"


def create_store(store: Path, names: Sequence[str], shape: tuple[int, ...]) -> None:
    """Make the store for frames of some names, or check that it is theirs.

    Parameters
    ----------
    store
        Its folder.
    names
        Of the frames, in their order.
    shape
        (channels, height, width) of a picture.

    Raises
    ------
    FileError
        If there is another store or something else, or it cannot be written.
    """
    whole = (len(names), *shape)
    with system_errors(store):
        if store.exists():
            if not _is_the_same(store, names, shape):
                raise FileError(
                    f"{store} is there, and is no Zarr store of these frames, {_text(whole)}, by "
                    "this version of nolens: give another name (--store)"
                )
            return
        _create(store, len(names), shape)
    write_attributes(store, names, [])


def write_attributes(store: Path, names: Sequence[str], rows: Sequence[dict[str, Any]]) -> None:
    """Write axes, units, names and records of the frames, and consolidate the metadata.

    Raises
    ------
    FileError
        If they cannot be written.
    """
    axes: list[dict[str, str]] = [
        {"name": "t", "type": "time"},
        {"name": "c", "type": "channel"},
        {"name": "y", "type": "space"},
        {"name": "x", "type": "space"},
    ]
    scale = [{"type": "scale", "scale": [1.0] * len(_AXES)}]
    level: Any = {"path": _LEVEL, "coordinateTransformations": scale}
    with system_errors(store):
        group = zarr.open_group(store, mode="r+")
        group.attrs.update(
            {
                "ome": {
                    "version": _VERSION,
                    "multiscales": [{"name": "radiance", "axes": axes, "datasets": [level]}],
                },
                "nolens": {
                    "unit": "counts of the measurement over those of the PSF",
                    "frames": _readable(names),
                    "rows": list(rows),
                },
            }
        )
        with warnings.catch_warnings():
            # Readers of many chunks need one file instead of two; others pass it over.
            warnings.simplefilter("ignore")
            zarr.consolidate_metadata(group.store)


def _create(store: Path | MemoryStore, count: int, shape: tuple[int, ...]) -> Any:
    group = zarr.create_group(store, zarr_format=3)
    return group.create_array(
        _LEVEL,
        shape=(count, *shape),
        chunks=(1, *shape),
        dtype="float32",
        dimension_names=_AXES,
        # A frame that is black is there, too.
        config={"write_empty_chunks": True},
    )


def _is_the_same(store: Path, names: Sequence[str], shape: tuple[int, ...]) -> bool:
    """Whether a store is as it would be made; one that was just begun has no attributes yet."""
    made = _create(MemoryStore(), len(names), shape)
    try:
        group = zarr.open_group(store, mode="r", zarr_format=3)
        attributes: Any = group.attrs.asdict()
        return bool(
            zarr.open_array(store / _LEVEL, mode="r").metadata == made.metadata
            and (not attributes or attributes["ome"]["version"] == _VERSION)
            and (not attributes or attributes["nolens"]["frames"] == _readable(names))
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _readable(names: Sequence[str]) -> list[str]:
    return [readable(name) for name in names]


def _text(shape: tuple[int, ...]) -> str:
    return "×".join(map(str, shape))
