"""From the numpy arrays of the format libraries to a frame."""

import numpy as np
import torch
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import FileError

_CHANNELS = {1: ("grey",), 3: ("R", "G", "B")}
_WHITE = {"uint8": 255.0, "uint16": 65535.0, "float16": None, "float32": None, "float64": None}


def frame_from_array(array: NDArray[np.generic], source: str) -> Frame:
    """A frame of an array (channels, height, width) of 8/16-bit counts or floats.

    Raises
    ------
    FileError
        If its type is another one, or it does not have one or three channels.
    """
    stored_as = array.dtype.name
    if stored_as not in _WHITE:
        raise FileError(
            f"{source} holds {stored_as}; accepted are {', '.join(_WHITE)}. Convert it, "
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
        white=_WHITE[stored_as],
        stored_as=stored_as,
        source=source,
    )
