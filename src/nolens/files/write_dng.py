"""Writing a mosaic as DNG, as a camera would."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from torch import Tensor

from nolens.camera import MOSAICS
from nolens.errors import DataError, OptionError
from nolens.files.atomic import atomic_write

_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_D65 = 21
_LARGEST = 2**32 - 1  # Of the two numbers of a fraction.
_SMALLEST = 22  # LibRaw takes a smaller picture for none.
# Linear sRGB from CIE XYZ (IEC 61966-2-1): the camera's colours are taken as sRGB's primaries.
_SRGB_FROM_XYZ = (
    3.2406,
    -1.5372,
    -0.4986,
    -0.9689,
    1.8758,
    0.0415,
    0.0557,
    -0.2040,
    1.0570,
)


def write_dng(
    path: str | Path,
    counts: Tensor | NDArray[np.uint16],
    *,
    pattern: str = "RGGB",
    black: int,
    white: int,
    exposure_s: float | None = None,
    model: str = "nolens simulated camera",
) -> None:
    """Write the counts of a colour mosaic as an uncompressed DNG 1.4.

    Parameters
    ----------
    path
        The file to write.
    counts
        Whole counts of 0 to 65535, (height, width), at least 22×22.
    pattern
        Colours of the 2×2 superpixel, row by row.
    black
        Count that stands for no light.
    white
        Count from which a pixel is saturated.
    exposure_s
        Exposure time in seconds; left out where a DNG cannot hold it.
    model
        Name of the camera, ASCII.

    Raises
    ------
    DataError
        If `counts` are not whole numbers of 0 to 65535 of shape (height, width).
    OptionError
        If the mosaic is unknown, or black is not below white within 0 to 65535.
    FileError
        If the file cannot be written.
    """
    if pattern not in MOSAICS:
        raise OptionError(f"unknown mosaic {pattern!r}; accepted are {', '.join(MOSAICS)}")
    if not 0 <= black < white <= 65535:
        raise OptionError(f"black {black}, white {white}: 0 ≤ black < white ≤ 65535 is needed")
    array = counts.detach().cpu().numpy() if isinstance(counts, Tensor) else np.asarray(counts)
    stored = array.astype(np.uint16)
    if array.ndim != 2 or min(array.shape) < _SMALLEST or not np.array_equal(stored, array):
        raise DataError(
            "a DNG holds whole counts of 0 to 65535 of shape (height, width), at least "
            f"{_SMALLEST}×{_SMALLEST}; given are {array.dtype} of shape {array.shape}"
        )
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            stored,
            byteorder="<",
            photometric="cfa",
            metadata=None,
            software="nolens",
            extratags=_tags(pattern, black, white, exposure_s, model),
        )


def _tags(
    pattern: str, black: int, white: int, exposure_s: float | None, model: str
) -> list[tuple[int, int, int, Any, bool]]:
    matrix = [part for value in _SRGB_FROM_XYZ for part in (round(value * 10_000), 10_000)]
    tags: list[tuple[int, int, int, Any]] = [
        (271, _ASCII, 0, "nolens"),
        (272, _ASCII, 0, model),
        (33421, _SHORT, 2, (2, 2)),
        (33422, _BYTE, 4, bytes("RGB".index(colour) for colour in pattern)),
        (50706, _BYTE, 4, bytes((1, 4, 0, 0))),
        (50707, _BYTE, 4, bytes((1, 1, 0, 0))),
        (50708, _ASCII, 0, model),
        (50710, _BYTE, 3, bytes((0, 1, 2))),
        (50711, _SHORT, 1, 1),
        (50713, _SHORT, 2, (1, 1)),
        (50714, _LONG, 1, black),
        (50717, _LONG, 1, white),
        (50721, _SRATIONAL, 9, matrix),
        (50728, _RATIONAL, 3, (1, 1, 1, 1, 1, 1)),
        (50778, _SHORT, 1, _D65),
    ]
    if exposure_s is not None and 1 / _LARGEST < exposure_s < _LARGEST:
        exposure = Fraction(exposure_s).limit_denominator(int(_LARGEST / max(1, exposure_s)))
        tags.append((33434, _RATIONAL, 1, (exposure.numerator, exposure.denominator)))
    return [(*tag, True) for tag in sorted(tags)]
