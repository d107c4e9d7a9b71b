"""Camera raw of all makers, by LibRaw."""

import struct
from pathlib import Path

import numpy as np
import rawpy
import tifffile
import torch

from nolens.camera import MOSAICS, Frame
from nolens.errors import FileError
from nolens.files.damage import damage
from nolens.files.limits import check_bytes, check_size
from nolens.files.quiet import quiet_library, quiet_stderr
from nolens.files.tiff_directories import check_directories

RAW_SUFFIXES = (
    ".dng",
    ".cr2",
    ".cr3",
    ".crw",
    ".nef",
    ".nrw",
    ".arw",
    ".sr2",
    ".raf",
    ".rw2",
    ".orf",
    ".pef",
    ".srw",
    ".3fr",
    ".iiq",
    ".raw",
)

_MAKE, _DNG_VERSION = 271, 50706
# What LibRaw says, and what damaged tags make of the code of rawpy and tifffile.
_DAMAGE = (
    rawpy.LibRawError,
    tifffile.TiffFileError,
    OSError,
    ValueError,
    LookupError,
    RuntimeError,
    ArithmeticError,
    TypeError,
    struct.error,
    MemoryError,
)


def read_raw(path: Path) -> Frame:
    """Read the visible area of the sensor, undeveloped, with its mosaic, black and white level.

    Raises
    ------
    FileError
        If the file is damaged or incomplete, no raw file, or its mosaic has no 2×2 superpixel.
    """
    check_bytes(path)
    try:
        _check_camera(path)
        with quiet_stderr(), rawpy.imread(str(path)) as raw:
            return _frame(path, raw)
    except _DAMAGE as error:
        said = error.args[0].decode() if error.args and isinstance(error.args[0], bytes) else error
        raise damage(
            path,
            "camera raw of a known kind",
            ValueError(said),
            "Copy it again from where it was made, or convert it to DNG",
        ) from error


def _check_camera(path: Path) -> None:
    """Refuse a plain TIFF, which LibRaw takes for a mosaic."""
    with path.open("rb") as file:
        if file.read(4) not in (b"II*\0", b"MM\0*"):
            return
    check_directories(path)
    with quiet_library("tifffile"), tifffile.TiffFile(path) as tiff:
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
        cell = [raw.raw_color(top + row, left + column) for row in (0, 1) for column in (0, 1)]
        mosaic = "".join(colours[index] for index in cell)
        channels, black, planes = ("mosaic",), tuple(blacks[i] for i in cell), counts[None]
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
