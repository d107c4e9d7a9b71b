"""Pictures between the studio and its pages: small JPEGs of frames and reconstructions, and scenes
that the simulated camera captures.
"""

import functools
import io
import json
import warnings
from typing import Any

import torch
from PIL import Image, ImageOps, UnidentifiedImageError
from torch import Tensor

from nolens.camera import Frame, arrange_rgb, linear_from_srgb, srgb_from_linear
from nolens.camera.measurement import rgb_counts
from nolens.capture import TwinSource, chart
from nolens.errors import DataError, NolensError
from nolens.files import check_scans
from nolens.files.sample_pictures import sample_picture
from nolens.studio.schemas import SCENES

_STEPS = 4096
_EXPOSED = 0.995
_FOLLOW = 0.25
_JUMP = 2.0
_QUALITY = 85
_MOST = 640
_MOST_SCENE_PIXELS = 50_000_000
_LONG_SIDE = 1024


class White:
    """Radiance that is displayed as white: the 99.5th percentile, followed slowly, so that a live
    picture does not flicker.
    """

    def __init__(self) -> None:
        self._white: float | None = None

    def follow(self, radiance: Tensor) -> float:
        """White for the next picture, (channels, height, width); at once where all has changed."""
        brightest = radiance.amax(dim=0).flatten()
        # A few thousand pixels say it as well as all of them.
        some = brightest[:: max(1, brightest.numel() // 20_000)]
        white = float(some.kthvalue(max(1, round(_EXPOSED * some.numel()))).values)
        if white <= 0:
            white = float(brightest.max())
        if white <= 0:
            return self._white or 1.0
        if self._white is None or not 1 / _JUMP < white / self._white < _JUMP:
            self._white = white
        else:
            self._white *= (white / self._white) ** _FOLLOW
        return self._white


def picture_jpeg(radiance: Tensor, channels: tuple[str, ...], white: float) -> bytes:
    """A reconstruction as sRGB JPEG."""
    return _jpeg(arrange_rgb(radiance, channels) / white)


def raw_jpeg(frame: Frame) -> bytes:
    """What the sensor measured, as JPEG: a pixel for each 2×2 superpixel of a mosaic, or fewer."""
    black = sum(frame.black) / len(frame.black)
    white = float(frame.counts.max()) if frame.white is None else frame.white
    pitch = 2 if frame.mosaic is not None else 1
    step = max(1, -(-max(frame.counts.shape[-2:]) // (pitch * _MOST)))
    return _jpeg((rgb_counts(frame, step) - black) / max(white - black, 1e-9))


def message(header: dict[str, Any], parts: dict[str, bytes]) -> bytes:
    """Header and JPEGs as the page reads them: length, JSON, one part after the other."""
    listed = [
        {"name": name, "type": "image/jpeg", "bytes": len(data)} for name, data in parts.items()
    ]
    text = json.dumps({**header, "parts": listed}, allow_nan=False).encode()
    return b"".join((len(text).to_bytes(4, "little"), text, *parts.values()))


@functools.cache
def _curve() -> Tensor:
    """Bytes of sRGB by steps of radiance."""
    return (srgb_from_linear(torch.linspace(0, 1, _STEPS)) * 255).round().to(torch.uint8)


def _jpeg(linear: Tensor) -> bytes:
    steps = (linear * (_STEPS - 1)).clamp_(0, _STEPS - 1).to(torch.int32)
    encoded = _curve().index_select(0, steps.flatten()).view(steps.shape)
    pixels = encoded.permute(1, 2, 0).contiguous().numpy()
    image = Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()


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


def decoded_scene(data: bytes, most_pixels: int = _MOST_SCENE_PIXELS) -> Tensor:
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
