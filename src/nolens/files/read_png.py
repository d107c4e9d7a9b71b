"""PNG pictures of 8 and 16 bits."""

import struct
from pathlib import Path
from typing import NamedTuple

import imagecodecs
import numpy as np
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array
from nolens.files.damage import damage
from nolens.files.limits import check_bytes, check_size
from nolens.files.quiet import quiet_stderr

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_CHANNELS = {0: 1, 2: 3, 3: 4, 4: 2, 6: 4}
"""By colour type; a palette may have alpha."""
_PALETTE = 3


def read_png(path: Path) -> Frame:
    """Read grey, colour or palette PNG; an alpha channel is dropped.

    Raises
    ------
    FileError
        If the file is damaged, too large, or has fewer than 8 bits.
    """
    array = read_png_samples(path)
    colours = 3 if array.shape[-1] >= 3 else 1
    return frame_from_array(np.moveaxis(array[..., :colours], -1, 0), str(path))


def read_png_samples(path: Path) -> NDArray[np.generic]:
    """Read (height, width, 1 to 4) of grey or colour, and alpha where there is one.

    Raises
    ------
    FileError
        If the file is damaged, too large, or has fewer than 8 bits.
    """
    check_bytes(path)
    try:
        data = path.read_bytes()
        header = _header(data)
        if header.bits < 8 and header.colour != _PALETTE:
            raise FileError(f"{path} is a PNG of {header.bits} bits: it needs 8 or 16")
        shape = (header.height, header.width, _CHANNELS[header.colour])
        check_size(shape, header.bits // 8, path)
        # libpng remarks on interlaced pictures, which it reads.
        with quiet_stderr():
            array: NDArray[np.generic] = imagecodecs.png_decode(data)
    except FileError:
        raise
    # Damage can raise nearly anything.
    except Exception as error:
        raise damage(path, "a PNG", error) from error
    return array[..., None] if array.ndim == 2 else array


class _Header(NamedTuple):
    width: int
    height: int
    bits: int
    colour: int


def _header(data: bytes) -> _Header:
    """First chunk of a file that has its last one: libpng does not miss that."""
    if not data.startswith(_SIGNATURE + b"\0\0\0\x0dIHDR"):
        raise ValueError("it has no header")
    start = len(_SIGNATURE)
    while (chunk := data[start : start + 8])[4:] != b"IEND":
        if len(chunk) < 8:
            raise ValueError("its end is missing")
        start += 12 + struct.unpack(">I4s", chunk)[0]
    if start + 12 > len(data):
        raise ValueError("its end is missing")
    return _Header(*struct.unpack(">IIBB", data[16:26]))
