"""Writing pictures, linear radiance and counts."""

import json
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from PIL import Image, PngImagePlugin
from torch import Tensor

from nolens.camera import exposure_white, srgb_from_linear
from nolens.errors import DataError
from nolens.files.atomic import atomic_write
from nolens.files.tiff_note import SOFTWARE


def write_png(path: str | Path, radiance: Tensor, white: float | None = None) -> None:
    """Write a picture as 8-bit PNG with the sRGB curve.

    Parameters
    ----------
    path
        The file to write.
    radiance
        Linear radiance, (1 or 3, height, width).
    white
        Radiance that is white; what is brighter clips. None takes `exposure_white` of the picture
        (its 99.5th percentile).

    Raises
    ------
    DataError
        If the picture is black everywhere, holds NaN, or does not have one or three channels.
    FileError
        If the file cannot be written.
    """
    white = exposure_white(radiance) if white is None else white
    encoded = srgb_from_linear(radiance / white).mul_(255).round_().to(torch.uint8)
    pixels = np.ascontiguousarray(_pixels(encoded))
    note = PngImagePlugin.PngInfo()
    note.add_text("Description", f"sRGB; the radiance {white:.9g} is white")
    with atomic_write(path) as temporary:
        # Photographs hold few repetitions but runs: as small as by zlib's default way in 0.4 of its
        # time.
        Image.fromarray(pixels).save(temporary, pnginfo=note, compress_type=zlib.Z_RLE)


def write_tiff16(path: str | Path, radiance: Tensor) -> None:
    """Write linear radiance as 16-bit TIFF: ``round(65535 radiance / white)``, clipped.

    White is `exposure_white` of the radiance; it stands in the file's description as JSON, with
    the radiance of one count.

    Parameters
    ----------
    path
        The file to write.
    radiance
        Linear radiance, (1 or 3, height, width).

    Raises
    ------
    DataError
        If the picture is black everywhere, holds NaN, or does not have one or three channels.
    FileError
        If the file cannot be written.
    """
    white = exposure_white(radiance)
    pixels = _pixels((radiance.double() / white).clamp(0, 1) * 65535).round().astype(np.uint16)
    _write_tiff(path, pixels, {"linear": True, "white": white, "per_count": white / 65535})


def write_tiff32(path: str | Path, radiance: Tensor) -> None:
    """Write linear radiance as it is, as 32-bit float TIFF.

    Parameters
    ----------
    path
        The file to write.
    radiance
        Linear radiance, (1 or 3, height, width).

    Raises
    ------
    DataError
        If the picture does not have one or three channels.
    FileError
        If the file cannot be written.
    """
    _write_tiff(
        path, _pixels(radiance).astype(np.float32), {"linear": True, "per_count": 1.0, "black": 0}
    )


def write_counts(
    path: str | Path,
    counts: Tensor,
    *,
    mosaic: str | None,
    black: float,
    white: int,
    exposure_s: float | None = None,
) -> None:
    """Write a sensor's counts as they are, as 16-bit TIFF.

    What else is known stands in the file's description as JSON; `read_frame` heeds it.

    Parameters
    ----------
    path
        The file to write.
    counts
        Whole counts of 0 to 65535, (height, width).
    mosaic
        Colours of the 2×2 superpixel, row by row; None without one.
    black
        Count that stands for no light.
    white
        Count from which a pixel is saturated.
    exposure_s
        Exposure time in seconds.

    Raises
    ------
    DataError
        If `counts` are not whole numbers of 0 to 65535 of shape (height, width).
    FileError
        If the file cannot be written.
    """
    array = counts.detach().cpu().numpy()
    stored = array.astype(np.uint16)
    if array.ndim != 2 or not np.array_equal(stored, array):
        raise DataError(
            "a 16-bit TIFF holds whole counts of 0 to 65535 of shape (height, width); given are "
            f"{array.dtype} of shape {array.shape}"
        )
    note = {"mosaic": mosaic, "black": black, "white": white, "exposure_s": exposure_s}
    _write_tiff(path, stored, note)


def _pixels(values: Tensor) -> NDArray[Any]:
    """(height, width) or (height, width, 3), as file formats have it."""
    if values.ndim != 3 or values.shape[0] not in (1, 3):
        raise DataError(
            f"a picture has (channels, height, width) with 1 or 3 channels, not "
            f"{tuple(values.shape)}"
        )
    array = values.detach().cpu().numpy()
    return array[0] if len(array) == 1 else np.moveaxis(array, 0, -1)


def _write_tiff(path: str | Path, pixels: NDArray[Any], note: dict[str, Any]) -> None:
    kind = "rgb" if pixels.ndim == 3 else "minisblack"
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            np.ascontiguousarray(pixels),
            photometric=kind,
            description=json.dumps(note),
            metadata=None,
            software=SOFTWARE,
        )
