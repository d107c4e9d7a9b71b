"""Pictures: radiance of scenes read from files, and radiance written for screens and programs."""

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
import torch
from numpy.typing import NDArray
from PIL import Image, ImageOps, PngImagePlugin
from torch import Tensor

from nolens.camera import Frame, exposure_white, linear_from_srgb, srgb_from_linear
from nolens.camera.values import all_finite, unusable
from nolens.errors import DataError, FileError
from nolens.files.arrays import read_png_samples
from nolens.files.atomic import atomic_write
from nolens.files.formats import Address
from nolens.files.frames import read_frame
from nolens.files.input import (
    check_bytes,
    check_content,
    check_exists,
    check_size,
    decoding,
    system_errors,
)
from nolens.files.sequences import open_sequence
from nolens.files.tiff import read_tiff_samples, write_tiff

_KINDS = {
    ".png": "PNG",
    ".jpg": "JPEG",
    ".jpeg": "JPEG",
    ".tif": "TIFF",
    ".tiff": "TIFF",
    **dict.fromkeys((".npy", ".npz", ".mat", ".h5", ".hdf5", ".zarr", ".exr"), "floats"),
}
PICTURE_SUFFIXES = tuple(_KINDS)
"""Suffixes of the files that `read_picture` reads."""
_ACCEPTED = (
    "A scene is a .png, .jpg or .tif of 8 or 16 bits (sRGB), or floats (linear, 1 is "
    "white): .exr, .tif, .npy, .npz, .mat, .h5, .zarr"
)
_ORIENTATION = 0x0112
"""EXIF tag; above 4, rows are columns."""
_END = {"PNG": b"IEND", "JPEG": b"\xff\xd9"}
_END_BYTES = 65536
"""Some programs add notes behind the end of a picture."""
_MOST_SCANS = 200
_BLOCK = 2**22

# Its limit is a fixed one; ours is looked at first.
Image.MAX_IMAGE_PIXELS = None


@dataclass(frozen=True)
class Picture:
    """A picture of a scene: linear radiance (3, height, width), float32; 1 is white.

    Its opacity (height, width) is 1 where it hides what is behind it; None: everywhere.
    """

    radiance: Tensor
    opacity: Tensor | None = None


def read_picture(path: str | Path, *, signed: bool = False) -> Picture:
    """Read grey or colour: sRGB of 8 or 16 bits, or linear radiance as floats.

    A .tif that this program wrote says that its 16 bits are linear. An alpha channel is the
    opacity. Grey counts as white light of that strength.

    Parameters
    ----------
    path
        The file.
    signed
        Whether values may be negative, as those of a filter are, which is no scene's light.

    Raises
    ------
    FileError
        If the file is missing, damaged, of another kind, or holds values that are not finite
        or negative.
    """
    path = Path(path)
    suffix = Address.of(path).file.suffix.lower()
    kind = _KINDS.get(suffix)
    if kind == "floats":
        frame = read_frame(path)
        if frame.white is not None:
            raise FileError(
                f"{path} holds {frame.stored_as}, of which it is not known what white is: save "
                "linear radiance as floats, 1 is white"
            )
        return Picture(_three(_finite(frame.counts, path, signed)))
    check_exists(path, _ACCEPTED)
    if kind is None:
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {_ACCEPTED}")
    check_content(path, (kind,), _ACCEPTED)
    multiplied, per_count = False, None
    if kind == "TIFF":
        samples = read_tiff_samples(path)
        array, alphas, multiplied = samples.values, samples.alphas, samples.alphas == (True,)
        note = samples.note
        if note.get("linear") is True and isinstance(note.get("per_count"), float):
            per_count = note["per_count"]
    else:
        values = read_png_samples(path) if kind == "PNG" else _read_jpeg(path)
        array = np.moveaxis(values, -1, 0)
        alphas = (False,) * (values.shape[-1] in (2, 4))
    if len(alphas) > 1 or len(array) - len(alphas) not in (1, 3) or 0 in array.shape:
        raise FileError(
            f"{path} has (channels, height, width) {array.shape}: a picture has one channel "
            "(grey) or three (R, G, B), and alpha or none"
        )
    if per_count is not None:
        linear = torch.from_numpy(array.astype(np.float32)).mul_(per_count)
        return Picture(_three(_finite(linear, path, signed)))
    return _picture(array, bool(alphas), multiplied, path, signed)


def read_moving_picture(path: Path) -> tuple[list[Picture], tuple[Path, ...]]:
    """Read the frames of a folder, a pattern, a list or a file of many, and name their files.

    Files of one picture each are read by `read_picture`; of others whole numbers are sRGB, and
    floats linear.

    Raises
    ------
    FileError
        As `read_picture` and `open_sequence`, and if the frames differ in size.
    """
    frames = open_sequence(path)
    if len(frames.sources) == len(frames):
        pictures = [read_picture(each) for each in frames.sources]
    else:
        pictures = [_picture_of(frames.read(number)) for number in range(len(frames))]
    sizes = sorted({tuple(each.radiance.shape[-2:]) for each in pictures})
    if len(sizes) > 1:
        raise FileError(
            f"the frames of {path} are of {len(sizes)} sizes, such as {sizes[0][0]}×{sizes[0][1]} "
            f"and {sizes[1][0]}×{sizes[1][1]}: give frames of one size"
        )
    return pictures, frames.sources


def _picture_of(frame: Frame) -> Picture:
    values = frame.counts if frame.white is None else frame.counts / frame.white
    linear = frame.stored_as.startswith("float")
    radiance = values if linear else linear_from_srgb(values)
    return Picture(_three(_finite(radiance, Path(frame.source), False)))


def picture_size(path: Path) -> tuple[int, int]:
    """Height and width of a picture, by the first and last bytes of its file.

    Raises
    ------
    FileError
        If it is missing, of another kind, or damaged there.
    """
    check_exists(path, _ACCEPTED)
    kind = _KINDS.get(path.suffix.lower())
    if kind not in ("PNG", "JPEG", "TIFF"):
        return read_frame(path).size
    check_content(path, (kind,), _ACCEPTED)
    with decoding(path, f"a {kind}"):
        if kind == "TIFF":
            with tifffile.TiffFile(path) as file:
                page = file.pages.first
                return page.imagelength, page.imagewidth
        with path.open("rb") as file:
            file.seek(max(0, path.stat().st_size - _END_BYTES))
            if _END[kind] not in file.read():
                raise ValueError("its end is missing")
        with Image.open(path, formats=[kind]) as picture:
            width, height = picture.size
            turned = kind == "JPEG" and picture.getexif().get(_ORIENTATION, 1) > 4
            return (width, height) if turned else (height, width)


def picture_of_samples(samples: NDArray[np.generic], source: str) -> Tensor:
    """Radiance (3, height, width) of (height, width, 1 or 3) sRGB samples of 8 or 16 bits."""
    return _picture(np.moveaxis(samples, -1, 0), False, False, Path(source)).radiance


def _picture(
    array: NDArray[np.generic], alpha: bool, multiplied: bool, path: Path, signed: bool = False
) -> Picture:
    whites = {"uint8": 255.0, "uint16": 65535.0, "float16": 1.0, "float32": 1.0, "float64": 1.0}
    name = array.dtype.name
    if name not in whites:
        raise FileError(f"{path} holds {name}. {_ACCEPTED}")
    with np.errstate(over="ignore"):
        values = torch.from_numpy(np.require(array, np.float32, ["C", "W"])).div_(whites[name])
    values = _finite(values, path, signed)
    colours, opacity = (values[:-1], values[-1].clamp_(max=1)) if alpha else (values, None)
    if opacity is not None and multiplied:
        colours.div_(opacity.clamp_min(1e-6))
    if name.startswith("uint"):
        # In parts: the curve takes four times its values.
        for part in torch.split(colours.view(-1), _BLOCK):
            part.copy_(linear_from_srgb(part))
    return Picture(_three(colours), opacity)


def _finite(values: Tensor, path: Path, signed: bool = False) -> Tensor:
    if not all_finite(values) or (float(values.min()) < 0 and not signed):
        raise FileError(
            f"{path} holds NaN, infinity or negative values: the light of a scene is finite and "
            "not negative"
        )
    reason = unusable(values)
    if reason is not None:
        raise FileError(f"{path} holds {reason}")
    return values


def _three(values: Tensor) -> Tensor:
    return values.expand(3, -1, -1)


def _read_jpeg(path: Path) -> NDArray[np.generic]:
    """(height, width, 1 or 3), upright."""
    check_bytes(path)
    with decoding(path, "a JPEG"), Image.open(path, formats=["JPEG"]) as picture:
        mode = picture.mode
        check_size((picture.height, picture.width, len(picture.getbands())), 1, path)
        check_scans(path.read_bytes(), path)
        array = np.asarray(ImageOps.exif_transpose(picture))
    if mode not in ("L", "RGB"):
        raise FileError(f"{path} is a JPEG of kind {mode}; accepted are grey and RGB. {_ACCEPTED}")
    return array[..., None] if array.ndim == 2 else array


def check_scans(data: bytes, source: str | Path) -> None:
    """Refuse a progressive JPEG of thousands of scans, each of which goes over all pixels.

    Raises
    ------
    FileError
        If it has more than 200.
    """
    scans = data.count(b"\xff\xda")
    if scans > _MOST_SCANS:
        raise FileError(
            f"{source} is a JPEG of {scans} scans, and at most {_MOST_SCANS} are read: save it "
            "again"
        )


def picture_files(path: Path, *, below: bool = False) -> list[Path]:
    """A picture's file, or all pictures of a folder by their names.

    Parameters
    ----------
    path
        The file or folder.
    below
        Whether those in folders below it count, too.

    Raises
    ------
    FileError
        If the folder has none.
    """
    if not path.is_dir():
        return [path]
    with system_errors(path):
        there = sorted(path.rglob("*") if below else path.iterdir())
    pictures = [
        each
        for each in there
        if each.suffix.lower() in PICTURE_SUFFIXES and not each.name.startswith(".")
    ]
    if not pictures:
        raise FileError(
            f"the folder {path} holds no picture; its files can be {', '.join(PICTURE_SUFFIXES)}"
        )
    return pictures


def write_png(path: str | Path, radiance: Tensor, white: float | None = None) -> None:
    """Write a picture as 8-bit PNG with the sRGB curve.

    Parameters
    ----------
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
    picture = screen_picture(radiance, white)
    note = PngImagePlugin.PngInfo()
    note.add_text("Description", f"sRGB; the radiance {white:.9g} is white")
    with atomic_write(path) as temporary:
        # Photographs hold few repetitions but runs: as small as by zlib's default way in 0.4 of its
        # time.
        picture.save(temporary, pnginfo=note, compress_type=zlib.Z_RLE)


def screen_picture(radiance: Tensor, white: float) -> Image.Image:
    """Radiance (1 or 3, height, width) as a picture for a screen, 8-bit sRGB.

    Raises
    ------
    DataError
        If it does not have one or three channels.
    """
    encoded = srgb_from_linear(radiance / white).mul_(255).round_().to(torch.uint8)
    return Image.fromarray(np.ascontiguousarray(_pixels(encoded)))


def write_tiff16(path: str | Path, radiance: Tensor) -> None:
    """Write linear radiance as 16-bit TIFF: ``round(65535 radiance / white)``, clipped.

    Radiance is (1 or 3, height, width). White is its `exposure_white`; it stands in the file's
    description as JSON, with the radiance of one count.

    Raises
    ------
    DataError
        If the picture is black everywhere, holds NaN, or does not have one or three channels.
    FileError
        If the file cannot be written.
    """
    white = exposure_white(radiance)
    pixels = _pixels((radiance.double() / white).clamp(0, 1) * 65535).round().astype(np.uint16)
    write_tiff(path, pixels, {"linear": True, "white": white, "per_count": white / 65535})


def write_tiff32(path: str | Path, radiance: Tensor, sensor: tuple[int, int] | None = None) -> None:
    """Write linear radiance, (1 or 3, height, width), as it is, as 32-bit float TIFF.

    Of a PSF, `sensor` is (height, width) of the camera's whole sensor in its pixels, which stands
    in the file's description (`Frame.sensor`).

    Raises
    ------
    DataError
        If the picture does not have one or three channels.
    FileError
        If the file cannot be written.
    """
    note: dict[str, Any] = {"linear": True, "per_count": 1.0, "black": 0}
    if sensor is not None:
        note["sensor"] = list(sensor)
    write_tiff(path, _pixels(radiance).astype(np.float32), note)


def _pixels(values: Tensor) -> NDArray[Any]:
    """(height, width) or (height, width, 3), as file formats have it."""
    if values.ndim != 3 or values.shape[0] not in (1, 3):
        raise DataError(
            f"a picture has (channels, height, width) with 1 or 3 channels, not "
            f"{tuple(values.shape)}"
        )
    array = values.detach().cpu().numpy()
    return array[0] if len(array) == 1 else np.moveaxis(array, 0, -1)
