"""Values of a file's pixels as the page reads them out: radiance or counts, and angles."""

import json
import math
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
import torch
from torch import Tensor

from nolens.errors import DataError, NolensError
from nolens.files import open_sequence, read_camera, read_frame, read_picture, read_record
from nolens.files.tiff import ome_channels, read_tiff_samples
from nolens.jobs.fields import record_beside
from nolens.twin import preview_model

_MOST_PIXELS = 30_000_000
_LEVELS = 65535
_RADII = 256
_SRGB = (".png", ".jpg", ".jpeg")
_TIFF = (".tif", ".tiff")
_BANDS = ".ome.tif"


def pixel_values(path: Path, camera: str | None) -> bytes:
    """Length of a header (4 bytes), the header as JSON, and a number for each value.

    A value is ``offset + step × number``, both of its channel. Numbers are uint16, little-endian,
    row by row, the channels of a pixel one after the other.

    Parameters
    ----------
    path
        A reconstruction, also of several bands, a measurement or any other picture.
    camera
        It was taken with this one, whose layers give the angle of a reconstruction's pixels.

    Raises
    ------
    NolensError
        If the file cannot be read, or is too large.
    """
    values, scale, header = _values(path)
    height, width = values.shape[-2:]
    if values.numel() > 3 * _MOST_PIXELS or height * width > _MOST_PIXELS:
        raise DataError(f"{path.name} has more than {_MOST_PIXELS // 10**6} million pixels")
    values = values.double()
    lowest, highest = values.amin((1, 2)), values.amax((1, 2))
    # Counts stay as they are.
    whole = lowest.min() >= 0 and highest.max() <= _LEVELS and torch.equal(values, values.round())
    offset = torch.zeros_like(lowest) if whole else lowest
    step = torch.ones_like(lowest) if whole else (highest - lowest) / _LEVELS
    step[step == 0] = 1
    scaled = (values - offset[:, None, None]) / step[:, None, None]
    numbers = scaled.round().numpy().astype("<u2")
    header |= {"height": height, "width": width}
    header |= {"offset": (offset * scale).tolist(), "step": (step * scale).tolist()}
    header["angles"] = None if camera is None else _angles(path, camera)
    text = json.dumps(header, allow_nan=False).encode()
    return b"".join((len(text).to_bytes(4, "little"), text, np.moveaxis(numbers, 0, -1).tobytes()))


def _values(path: Path) -> tuple[Tensor, float, dict[str, Any]]:
    """Values (channels, height, width), what one is in their unit, and what is known of them."""
    suffix = path.suffix.lower()
    if path.name.lower().endswith(_BANDS):
        frames = open_sequence(path)
        bands = torch.cat([frames.read(number).counts for number in range(len(frames))])
        return bands, 1.0, _header("radiance", ome_channels(path))
    if suffix in _TIFF:
        samples = read_tiff_samples(path)
        per_count = samples.note.get("per_count")
        if samples.note.get("linear") is True and isinstance(per_count, float):
            names = ["R", "G", "B"] if len(samples.values) == 3 else ["grey"]
            # What is brighter than white is not in the file.
            clipped = samples.values.dtype == np.uint16
            values = torch.from_numpy(samples.values.astype(np.float32))
            return values, per_count, _header("radiance", names, clipped=clipped)
    if suffix in _SRGB:
        return read_picture(path).radiance, 1.0, _header("of white", ["R", "G", "B"])
    frame = read_frame(path)
    return frame.counts, 1.0, _header("counts", [*frame.channels], mosaic=frame.mosaic)


def _header(
    unit: str, channels: list[str], *, mosaic: str | None = None, clipped: bool = False
) -> dict[str, Any]:
    return {"unit": unit, "channels": channels, "mosaic": mosaic, "clipped": clipped}


def _angles(path: Path, camera: str) -> dict[str, Any] | None:
    """Where the axis lies in a reconstruction, in its pixels, and the tangent of the field angle
    at equal steps of the distance from there; None where its record does not say.
    """
    try:
        parameters = read_record(record_beside(path)).parameters
        twin = preview_model(read_camera(camera))
    except NolensError:
        return None
    window, by = parameters.get("window"), parameters.get("bin")
    sensor, turned = parameters.get("sensor"), parameters.get("flip")
    if not _is_window(window) or not isinstance(by, int) or by < 1:
        return None
    if sensor != [each // by for each in twin.shape]:  # Another camera's.
        return None
    top, left, height, width = window
    # The pixel on the axis is one of the sensor's own; those of the picture are by × by of them.
    row, column = ((each // 2 - (by - 1) / 2) / by for each in twin.shape)
    axis = [column - left, row - top]
    if turned in ("horizontal", "both"):
        axis[0] = width - 1 - axis[0]
    if turned in ("vertical", "both"):
        axis[1] = height - 1 - axis[1]
    farthest = math.hypot(
        *(max(abs(at), abs(size - 1 - at)) for at, size in zip(axis, (width, height), strict=True))
    )
    distance = torch.linspace(0, farthest, _RADII, dtype=torch.float64)
    p = twin.stack().ray(distance * by * twin.pixel_um)
    tangents = (p / (1 - p * p).sqrt()).tolist()
    return {"axis": axis, "step": farthest / (_RADII - 1), "tangents": tangents}


def _is_window(value: Any) -> TypeGuard[list[int]]:
    four = isinstance(value, list) and len(value) == 4
    return four and all(isinstance(each, int) and abs(each) < 10**6 for each in value)
