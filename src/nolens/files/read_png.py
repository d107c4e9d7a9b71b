"""PNG pictures of 8 and 16 bits."""

import warnings
from pathlib import Path

import numpy as np
import png
from numpy.typing import NDArray
from PIL import Image

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array

_GREY, _PALETTE = 0, 3


def read_png(path: Path) -> Frame:
    """Read grey, colour or palette PNG; an alpha channel is dropped.

    Raises
    ------
    FileError
        If the file is damaged, or has fewer than 8 bits.
    """
    array = read_png_samples(path)
    colours = 3 if array.shape[-1] >= 3 else 1
    return frame_from_array(np.moveaxis(array[..., :colours], -1, 0), str(path))


def read_png_samples(path: Path) -> NDArray[np.generic]:
    """Read (height, width, 1 to 4) of grey or colour, and alpha where there is one.

    Raises
    ------
    FileError
        If the file is damaged, or has fewer than 8 bits.
    """
    try:
        with path.open("rb") as file:
            header = png.Reader(file=file)
            header.preamble()
            bits, colour = header.bitdepth, header.color_type
        if bits < 8 and colour != _PALETTE:
            raise FileError(f"{path} is a PNG of {bits} bits: it needs 8 or 16")
        # Pillow reduces 16-bit colour to 8 bits without a word.
        return _read_deep(path) if bits == 16 and colour != _GREY else _read_plain(path, bits)
    except FileError:
        raise
    # Damage can raise nearly anything from either library.
    except Exception as error:
        raise FileError(
            f"{path} cannot be read as a PNG: it is damaged or incomplete ({error}). Copy it "
            "again from where it was made"
        ) from error


def _read_plain(path: Path, bits: int) -> NDArray[np.generic]:
    """By Pillow."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", Image.DecompressionBombWarning)
        with Image.open(path, formats=["PNG"]) as picture:
            plain = picture.convert("RGBA") if picture.mode == "P" else picture
            # Older Pillow opens 16-bit grey as 32-bit integers.
            array = np.asarray(plain).astype(np.uint16 if bits == 16 else np.uint8)
    return array[..., None] if array.ndim == 2 else array


def _read_deep(path: Path) -> NDArray[np.generic]:
    """16-bit colour, or grey beside alpha, by pypng."""
    with path.open("rb") as file:
        width, height, rows, info = png.Reader(file=file).read()
        array = np.array([np.frombuffer(row, np.uint16) for row in rows])
    return array.reshape(height, width, info["planes"])
