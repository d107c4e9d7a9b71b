"""Arrays of numpy."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array
from nolens.files.limits import check_size

_CHANNEL_COUNTS = (1, 3)


def read_npy(path: Path) -> Frame:
    """Read H×W, H×W×C or C×H×W (C of 1 or 3) of 8/16-bit counts or 16/32/64-bit floats.

    Raises
    ------
    FileError
        If the file is damaged or holds something else.
    """
    return frame_of_npy(open_npy(path), str(path))


def open_npy(path: Path) -> NDArray[Any]:
    """Map an npy file into memory.

    Raises
    ------
    FileError
        If the file is damaged.
    """
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


def frame_of_npy(array: NDArray[Any], source: str) -> Frame:
    """Frame of an array that came from `source`.

    Raises
    ------
    FileError
        If it is too large, or its shape or its kind of numbers is not that of a frame.
    """
    check_size(array.shape, array.dtype.itemsize, source)
    if array.ndim == 2:
        return frame_from_array(array[None], source)
    if array.ndim == 3:
        first, last = array.shape[0] in _CHANNEL_COUNTS, array.shape[2] in _CHANNEL_COUNTS
        if first and last:
            raise FileError(
                f"{source} has the shape {array.shape}, whose channels can be the first axis or "
                "the last: save it as (height, width)"
            )
        if first or last:
            return frame_from_array(array if first else np.moveaxis(array, -1, 0), source)
    raise FileError(
        f"{source} has the shape {array.shape}; accepted are (height, width), "
        "(height, width, 1 or 3) and (1 or 3, height, width)"
    )
