"""The chain of directories of a TIFF, looked at before a library loads what they name."""

import os
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from nolens.errors import FileError

MOST_PAGES = 10_000
"""Directories of one file."""
_MOST_TAGS = 1000
_MOST_BYTES = 2**24
"""Of the values of one tag: places of strips, texts, colour profiles."""
_SIZES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8], np.uint64)
"""Bytes of a value, by its type."""


def check_directories(path: Path) -> None:
    """Refuse a TIFF, or a raw file built like one, whose directories alone would fill the memory.

    Where the chain is broken it is left to the reader, which says so.

    Raises
    ------
    FileError
        If there are too many directories, or tags in one, or a tag has too many values.
    """
    with path.open("rb") as file:
        try:
            _walk(path, file)
        except struct.error:  # It ends in the middle of a directory.
            return


def _walk(path: Path, file: BinaryIO) -> None:
    order = "<" if file.read(2) == b"II" else ">"
    (version,) = struct.unpack(f"{order}H", file.read(2))
    big = version == 43
    count, entry, offset = ("Q", 20, "Q") if big else ("H", 12, "I")
    file.seek(8 if big else 4)
    length = os.fstat(file.fileno()).st_size
    seen = set[int]()
    while 0 < (place := _one(file, order + offset)) < length and place not in seen:
        seen.add(place)
        if len(seen) > MOST_PAGES:
            raise FileError(
                f"{path} has more than {MOST_PAGES} pages: give a folder of files, or an .npy"
            )
        file.seek(place)
        tags = _one(file, order + count)
        if tags > _MOST_TAGS:
            raise _damaged(path, f"a page with {tags} tags")
        data = file.read(tags * entry)
        if len(data) < tags * entry:
            return
        fields = np.frombuffer(
            data,
            [
                ("code", f"{order}u2"),
                ("type", f"{order}u2"),
                ("count", f"{order}u{8 if big else 4}"),
                ("value", f"V{8 if big else 4}"),
            ],
        )
        sizes = _SIZES[np.minimum(fields["type"], len(_SIZES) - 1)].astype(np.float64)
        held = sizes * fields["count"]
        if held.size and held.max() > _MOST_BYTES:
            tag = fields[int(held.argmax())]
            raise _damaged(path, f"{int(tag['count'])} values of its tag {int(tag['code'])}")


def _one(file: BinaryIO, form: str) -> int:
    (value,) = struct.unpack(form, file.read(struct.calcsize(form)))
    return int(value)


def _damaged(path: Path, what: str) -> FileError:
    return FileError(
        f"{path} cannot be read as a TIFF: its directory announces {what}, more than any picture "
        "has. Copy it again from where it was made"
    )
