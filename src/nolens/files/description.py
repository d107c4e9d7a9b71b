"""What a file holds, in figures."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import Frame, dark_corner
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError
from nolens.files.names import readable


def describe(frame: Frame) -> dict[str, Any]:
    """Describe a frame for a person or a program, in values that JSON has.

    Parameters
    ----------
    frame
        The frame, as `read_frame` gives it.

    Returns
    -------
    dict
        Format, height, width, channels, mosaic, stored type, black, white, exposure in seconds;
        lowest, highest and mean count of each channel or colour of the mosaic; how many values
        are not finite; how many have the highest count (a sensor that saturates below the white
        level shows many); percent saturated; level of the darkest corner. None where unknown.
    """
    usable = frame.counts[torch.isfinite(frame.counts)]
    try:
        corner = _finite(dark_corner(frame))
    except DataError:
        corner = None
    return {
        "file": readable(frame.source),
        "format": Path(frame.source).suffix.lstrip(".").lower(),
        "height": frame.counts.shape[-2],
        "width": frame.counts.shape[-1],
        "channels": list(frame.channels),
        "mosaic": frame.mosaic,
        "stored_as": frame.stored_as,
        "black": list(frame.black),
        "white": frame.white,
        "exposure_s": frame.exposure_s,
        "counts": {name: _range(values) for name, values in _colours(frame).items()},
        "not_finite": frame.counts.numel() - usable.numel(),
        "at_highest": int((usable == usable.max()).sum()) if usable.numel() else 0,
        "saturated_percent": (
            None
            if frame.white is None
            else 100 * float((frame.counts >= frame.white).double().mean())
        ),
        "dark_corner": corner,
    }


def _colours(frame: Frame) -> dict[str, Tensor]:
    if frame.mosaic is None:
        return dict(zip(frame.channels, frame.counts, strict=True))
    planes = colour_planes(frame.counts, frame.mosaic)
    return {colour: torch.cat([p.flatten() for p in cells]) for colour, cells in planes.items()}


def _range(values: Tensor) -> dict[str, float] | None:
    usable = values[torch.isfinite(values)]
    if not usable.numel():
        return None
    return {
        "min": float(usable.min()),
        "max": float(usable.max()),
        "mean": float(usable.double().mean()),
    }


def _finite(value: float) -> float | None:
    return value if torch.isfinite(torch.tensor(value)) else None
