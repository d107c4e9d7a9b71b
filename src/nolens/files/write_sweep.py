"""Writing a sweep through the depths of a scene as an animated PNG."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

from nolens.camera import srgb_from_linear
from nolens.files.atomic import atomic_write
from nolens.files.write_stack import depth_text

_STRIP = 26
_NARROWEST = 150
_INK, _PALE, _PAPER = (235, 235, 235), (110, 110, 110), (20, 20, 20)
_LABEL = 76
_PAUSE_MS, _STEP_MS = 700, 220


def page_picture(page: Tensor, white: float) -> Image.Image:
    """Radiance (1 or 3, rows, columns) as a picture for a screen, 8-bit sRGB."""
    shown = (srgb_from_linear(page / white) * 255).round().to("cpu").numpy().astype(np.uint8)
    return Image.fromarray(shown[0] if len(shown) == 1 else np.moveaxis(shown, 0, -1))


def page_png(page: Tensor, white: float) -> bytes:
    """The same as the bytes of a PNG file."""
    held = BytesIO()
    page_picture(page, white).save(held, "png", optimize=True)
    return held.getvalue()


def write_sweep(
    path: str | Path,
    pages: Tensor,
    depths_um: Sequence[float],
    places: Sequence[float],
    *,
    white: float,
) -> None:
    """Write pictures at many depths as one animated PNG, there and back, without an end.

    Parameters
    ----------
    path
        The file to write.
    pages
        Radiance, (depths, 1 or 3, rows, columns).
    depths_um
        Of the pages; each is written under its picture.
    places
        Where the depths lie between the first (0) and the last (1), in 1/z.
    white
        Radiance that is white in all of them.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    frames = [
        _labelled(page_picture(page, white), depth_text(depth), place)
        for page, depth, place in zip(pages, depths_um, places, strict=True)
    ]
    pauses = [_STEP_MS] * len(frames)
    pauses[0] = pauses[-1] = _PAUSE_MS
    back = slice(-2, 0, -1)
    with atomic_write(path) as temporary:
        frames[0].save(
            temporary,
            format="png",
            save_all=True,
            append_images=[*frames[1:], *frames[back]],
            duration=[*pauses, *pauses[back]],
            loop=0,
        )


def _labelled(picture: Image.Image, text: str, place: float) -> Image.Image:
    """The picture above its depth, and where that lies among all of them."""
    width = max(picture.width, _NARROWEST)
    frame = Image.new("RGB", (width, picture.height + _STRIP), _PAPER)
    frame.paste(picture, ((width - picture.width) // 2, 0))
    draw = ImageDraw.Draw(frame)
    middle = picture.height + _STRIP // 2
    draw.text((8, middle), text, fill=_INK, font=ImageFont.load_default(13), anchor="lm")
    left, right = _LABEL, width - 12
    draw.line((left, middle, right, middle), fill=_PALE, width=2)
    at = left + place * (right - left)
    draw.ellipse((at - 4, middle - 4, at + 4, middle + 4), fill=_INK)
    return frame
