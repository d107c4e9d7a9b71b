"""Scenes that the twin can be shown: built in, or pictures that come from the page."""

import io
import warnings

import torch
from PIL import Image, ImageOps, UnidentifiedImageError
from torch import Tensor

from nolens.camera import linear_from_srgb
from nolens.capture import TwinSource, chart
from nolens.errors import DataError, NolensError
from nolens.files import check_scans
from nolens.jobs.sample_pictures import sample_picture
from nolens.studio.schemas import SCENES

_MOST_PIXELS = 50_000_000
_LONG_SIDE = 1024


def show_scene(twin: TwinSource, name: str) -> None:
    """Let a simulated camera look at a built-in scene.

    Raises
    ------
    DataError
        If there is none of this name.
    OptionError
        If it comes with scikit-image, which is not installed.
    """
    if name == "point":
        twin.show_point()
        return
    if name == "dark":
        twin.show_dark()
        return
    if name not in SCENES:
        raise DataError(f"there is no scene {name!r}: give one of {', '.join(SCENES)}")
    photograph = name != "chart"
    twin.show(sample_picture(name, f"the scene {name} comes") if photograph else chart())


def decoded_scene(data: bytes, most_pixels: int = _MOST_PIXELS) -> Tensor:
    """A JPEG, PNG or WebP as a scene, its long side at most 1024 pixels.

    Parameters
    ----------
    data
        Its bytes.
    most_pixels
        More are refused by its header, before anything is decoded.

    Raises
    ------
    DataError
        If it is no such picture, damaged, or too large.
    FileError
        If it is a JPEG of more than 200 scans.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data), formats=["JPEG", "PNG", "WEBP"]) as image:
                if image.width * image.height > most_pixels:
                    raise DataError(
                        f"the picture is {image.width}×{image.height} pixels: give one of at most "
                        f"{most_pixels // 10**6} megapixels"
                    )
                check_scans(data, "the picture")
                image.draft("RGB", (_LONG_SIDE, _LONG_SIDE))
                upright = ImageOps.exif_transpose(image).convert("RGB")
                upright.thumbnail((_LONG_SIDE, _LONG_SIDE))
    except NolensError:
        raise
    # Damage can raise nearly anything.
    except Exception as error:
        # Pillow says which object in memory is no picture.
        reason = "" if isinstance(error, UnidentifiedImageError) else f" ({error})"
        raise DataError(f"the picture cannot be read{reason}: give a JPEG, PNG or WebP") from error
    pixels = torch.frombuffer(bytearray(upright.tobytes()), dtype=torch.uint8)
    planes = pixels.reshape(upright.height, upright.width, 3).permute(2, 0, 1)
    return linear_from_srgb(planes.float() / 255)
