"""Camera raw: files of all makers read by LibRaw, and mosaics written as DNG."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import rawpy
import tifffile
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.camera import MOSAICS, Frame
from nolens.errors import DataError, FileError, OptionError
from nolens.files.atomic import atomic_write
from nolens.files.formats import FrameSequence, refuse_dataset, single
from nolens.files.input import DESCRIBE_BARE, check_bytes, check_size, decoding, quiet_stderr
from nolens.files.tiff import SOFTWARE, check_directories, open_tiff

_MAKE, _DNG_VERSION = 271, 50706
_BYTE, _ASCII, _SHORT, _LONG, _RATIONAL, _SRATIONAL = 1, 2, 3, 4, 5, 10
_D65 = 21
_LARGEST_PART = 2**32 - 1  # Of the two numbers of a fraction.
_SMALLEST_SIDE = 22  # LibRaw takes a smaller picture for none.
# Linear sRGB from CIE XYZ (IEC 61966-2-1): the camera's colours are taken as sRGB's primaries.
_SRGB_FROM_XYZ = (
    (3.2406, -1.5372, -0.4986),
    (-0.9689, 1.8758, 0.0415),
    (0.0557, -0.2040, 1.0570),
)


def open_raw(path: Path, dataset: str | None) -> FrameSequence:
    """Open camera raw.

    Raises
    ------
    FileError
        If a data set is named, which it has none of.
    """
    refuse_dataset(path, dataset)
    return single(path, read_raw)


def read_raw(path: Path) -> Frame:
    """Read the visible area of the sensor, undeveloped, with its mosaic, black and white level.

    Raises
    ------
    FileError
        If the file is damaged or incomplete, no raw file, or its mosaic has no 2×2 superpixel.
    """
    check_bytes(path)
    advice = "Copy it again from where it was made, or convert it to DNG"
    if path.suffix.lower() == ".raw":
        advice += f"; if it is a sensor's bare data, {DESCRIBE_BARE}"
    with decoding(path, "camera raw of a known kind", advice):
        _check_camera(path)
        with quiet_stderr(), rawpy.imread(str(path)) as raw:
            return _frame(path, raw)


def _check_camera(path: Path) -> None:
    """Refuse a plain TIFF, which LibRaw takes for a mosaic."""
    with path.open("rb") as file:
        if file.read(4) not in (b"II*\0", b"MM\0*"):
            return
    check_directories(path)
    with open_tiff(path) as tiff:
        tags = tiff.pages.first.tags
        if _DNG_VERSION not in tags and _MAKE not in tags:
            raise FileError(
                f"{path} is a plain TIFF that names neither a camera nor a DNG version: rename it "
                f"to {path.with_suffix('.tif').name}, and give --mosaic if it has one"
            )


def _frame(path: Path, raw: rawpy.RawPy) -> Frame:
    sizes = raw.sizes
    check_size((sizes.raw_height, sizes.raw_width), 2, path)
    counts = raw.raw_image_visible  # Decodes it.
    check_size(counts.shape, 2, path)
    colours = raw.color_desc.decode()
    blacks = [float(level) for level in raw.black_level_per_channel]
    exposure = float(raw.other.shutter_speed)
    mosaic: str | None = None
    if counts.ndim == 3 and raw.num_colors == 3:
        channels: tuple[str, ...] = ("R", "G", "B")
        black = tuple(blacks[:3])
        planes = np.moveaxis(counts[..., :3], -1, 0)
    elif counts.ndim == 2 and raw.num_colors == 1:
        channels, black, planes = ("grey",), (blacks[0],), counts[None]
    elif counts.ndim == 2 and getattr(raw.raw_pattern, "shape", None) == (2, 2):
        top, left = raw.sizes.top_margin, raw.sizes.left_margin
        superpixel = [
            raw.raw_color(top + row, left + column) for row in (0, 1) for column in (0, 1)
        ]
        mosaic = "".join(colours[index] for index in superpixel)
        channels, black, planes = ("mosaic",), tuple(blacks[i] for i in superpixel), counts[None]
    else:
        raise FileError(
            f"{path} has a colour mosaic that does not repeat every 2×2 pixels "
            f"(such as X-Trans). Accepted are {', '.join(MOSAICS)}, and no mosaic"
        )
    if mosaic is not None and mosaic not in MOSAICS:
        raise FileError(f"{path} has the colour mosaic {mosaic}. Accepted are {', '.join(MOSAICS)}")
    levels = [raw.white_level, *(raw.camera_white_level_per_channel or [])]
    return Frame(
        counts=torch.from_numpy(planes.astype(np.float32)),
        channels=channels,
        mosaic=mosaic,
        black=black if len(set(black)) > 1 else black[:1],
        white=float(min(level for level in levels if level > 0)),
        stored_as=counts.dtype.name,
        source=str(path),
        exposure_s=exposure if exposure > 0 else None,
        black_stated=True,
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
    if array.ndim != 2 or min(array.shape) < _SMALLEST_SIDE or not np.array_equal(stored, array):
        raise DataError(
            "a DNG holds whole counts of 0 to 65535 of shape (height, width), at least "
            f"{_SMALLEST_SIDE}×{_SMALLEST_SIDE}; given are {array.dtype} of shape {array.shape}"
        )
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            stored,
            byteorder="<",
            photometric="cfa",
            metadata=None,
            software=SOFTWARE,
            extratags=_dng_tags(pattern, black, white, exposure_s, model),
        )


def _dng_tags(
    pattern: str, black: int, white: int, exposure_s: float | None, model: str
) -> list[tuple[int, int, int, Any, bool]]:
    numbers = (number for row in _SRGB_FROM_XYZ for number in row)
    matrix = [part for number in numbers for part in (round(number * 10_000), 10_000)]
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
    if exposure_s is not None and 1 / _LARGEST_PART < exposure_s < _LARGEST_PART:
        exposure = Fraction(exposure_s).limit_denominator(int(_LARGEST_PART / max(1, exposure_s)))
        tags.append((33434, _RATIONAL, 1, (exposure.numerator, exposure.denominator)))
    return [(*tag, True) for tag in sorted(tags)]
