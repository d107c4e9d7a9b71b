"""From counts and radiance to the small pictures that the page shows."""

import io
import json
from typing import Any

import torch
from PIL import Image
from torch import Tensor

from nolens.camera import Frame, arrange_rgb, srgb_from_linear
from nolens.camera.measurement import colour_planes

_STEPS = 4096
_CURVE = (srgb_from_linear(torch.linspace(0, 1, _STEPS)) * 255).round().to(torch.uint8)
_EXPOSED = 0.995
_FOLLOW = 0.25
_JUMP = 2.0
_QUALITY = 85
_MOST = 640


class White:
    """Radiance that is shown as white: the 99.5th percentile, followed slowly, so that a live
    picture does not flicker.
    """

    def __init__(self) -> None:
        self._white: float | None = None

    def follow(self, radiance: Tensor) -> float:
        """White for the next picture, (channels, height, width); at once where all has changed."""
        brightest = radiance.amax(dim=0).flatten()
        # A few thousand cells say it as well as all of them.
        some = brightest[:: max(1, brightest.numel() // 20_000)]
        found = float(some.kthvalue(max(1, round(_EXPOSED * some.numel()))).values)
        if found <= 0:
            found = float(brightest.max())
        if found <= 0:
            return self._white or 1.0
        if self._white is None or not 1 / _JUMP < found / self._white < _JUMP:
            self._white = found
        else:
            self._white *= (found / self._white) ** _FOLLOW
        return self._white


def picture_jpeg(radiance: Tensor, channels: tuple[str, ...], white: float) -> bytes:
    """A reconstruction as sRGB JPEG."""
    return _jpeg(arrange_rgb(radiance, channels) / white)


def raw_jpeg(frame: Frame) -> bytes:
    """What the sensor measured, as JPEG: a pixel for each 2×2 superpixel of a mosaic, or fewer."""
    black = sum(frame.black) / len(frame.black)
    white = float(frame.counts.max()) if frame.white is None else frame.white
    cells = 2 if frame.mosaic is not None else 1
    step = max(1, -(-max(frame.counts.shape[-2:]) // (cells * _MOST)))
    if frame.mosaic is not None:
        rows, columns = (count // 2 * 2 for count in frame.counts.shape[-2:])
        planes = colour_planes(frame.counts[0, :rows, :columns], frame.mosaic)
        shown = torch.stack(
            [
                torch.stack([part[::step, ::step] for part in parts]).mean(dim=0)
                for parts in planes.values()
            ]
        )
    else:
        shown = arrange_rgb(frame.counts, frame.channels)[:, ::step, ::step]
    return _jpeg((shown - black) / max(white - black, 1e-9))


def message(header: dict[str, Any], parts: dict[str, bytes]) -> bytes:
    """Header and JPEGs as the page reads them: length, JSON, one part after the other."""
    listed = [
        {"name": name, "type": "image/jpeg", "bytes": len(data)} for name, data in parts.items()
    ]
    text = json.dumps({**header, "parts": listed}, allow_nan=False).encode()
    return b"".join((len(text).to_bytes(4, "little"), text, *parts.values()))


def _jpeg(linear: Tensor) -> bytes:
    steps = (linear * (_STEPS - 1)).clamp_(0, _STEPS - 1).to(torch.int32)
    shown = _CURVE.index_select(0, steps.flatten()).view(steps.shape)
    pixels = shown.permute(1, 2, 0).contiguous().numpy()
    image = Image.fromarray(pixels[..., 0] if pixels.shape[-1] == 1 else pixels)
    buffer = io.BytesIO()
    image.save(buffer, "JPEG", quality=_QUALITY)
    return buffer.getvalue()
