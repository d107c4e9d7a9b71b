"""Data sets of files that have several: which of them are the frames."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nolens.errors import FileError
from nolens.files.arrays import STORED

MOST_DATASETS = 1000
"""Of one file, that are looked at."""
_MOST_NAMED = 8


class Dataset(NamedTuple):
    """What a file says of an array in it, before that is read."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def can_be_frames(self) -> bool:
        """Whether it is more than a number or a list of some, of a type that frames have."""
        return sum(each > 1 for each in self.shape) > 1 and self.dtype.name in STORED

    def __str__(self) -> str:
        return f"{'×'.join(map(str, self.shape)) or 'one number'}, {self.dtype.name}"


def choose_dataset(path: Path, there: Mapping[str, Dataset], asked: str | None) -> str:
    """Name of the data set that is asked for, or of the only one that can be frames.

    Raises
    ------
    FileError
        If there is no such one, none or several.
    """
    if asked is not None and asked.strip("/") in there:
        return asked.strip("/")
    able = {name: each for name, each in there.items() if each.can_be_frames}
    shown = [f":/{name} ({each})" for name, each in (able or there).items()]
    text = ", ".join(shown[:_MOST_NAMED]) + ", …" * (len(shown) > _MOST_NAMED)
    if asked is not None:
        raise FileError(f"{path} has no data set {asked!r}; it has {text or 'none'}")
    if not able:
        raise FileError(
            f"{path} has no data set that can be frames; it has {text or 'none'}. Accepted are "
            f"two axes or more of {', '.join(STORED)}"
        )
    if len(able) > 1:
        raise FileError(
            f"{path} has {len(able)} data sets that can be frames: {text}. Name the one, such as "
            f"{path}:/{next(iter(able))}"
        )
    return next(iter(able))
