"""Writing focal stacks and depth maps as TIFF."""

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import tifffile
from torch import Tensor

from nolens.files.atomic import atomic_write
from nolens.files.tiff import SOFTWARE

_MM = "mm"


def depth_text(depth_um: float) -> str:
    """A depth as people say it, with three digits."""
    if math.isinf(depth_um):
        return "infinity"
    for unit, size in (("m", 1e6), ("cm", 1e4)):
        if depth_um >= size:
            return f"{depth_um / size:.3g} {unit}"
    return f"{depth_um / 1e3:.3g} {_MM}"


def write_stack(
    path: str | Path, pages: Tensor, depths_um: Sequence[float], *, white: float
) -> None:
    """Write a focal stack as one 16-bit TIFF of many pages, linear, as ImageJ reads it.

    Every page, or every channel of one, is a slice with its depth as its label; `depths_mm` in
    the file's description has them all.

    Parameters
    ----------
    path
        The file to write.
    pages
        Radiance, (depths, 1 or 3, rows, columns).
    depths_um
        Of the pages.
    white
        Radiance that 65535 stands for, in all of them; what is brighter clips.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    counts = ((pages.double() / white).clamp(0, 1) * 65535).round().numpy().astype(np.uint16)
    colour = counts.shape[1] == 3
    names = ("R", "G", "B") if colour else ("",)
    labels = [f"{depth_text(each)} {name}".strip() for each in depths_um for name in names]
    more = {"mode": "composite"} if colour else {}
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            counts if colour else counts[:, 0],
            imagej=True,
            photometric="minisblack",
            metadata={
                "axes": "ZCYX" if colour else "ZYX",
                "Labels": labels,
                **more,
                "depths_mm": ",".join(_number(each) for each in depths_um),
                "linear": "true",
                "per_count": f"{white / 65535:.9g}",
            },
        )


def write_depths(path: str | Path, per_m: Tensor) -> None:
    """Write a depth map as 32-bit float TIFF in mm; infinity stays infinite.

    Parameters
    ----------
    path
        The file to write.
    per_m
        1/z of every pixel in 1/m, (rows, columns).

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    millimetres = (1e3 / per_m.clamp_min(0)).numpy().astype(np.float32)
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            millimetres,
            photometric="minisblack",
            metadata=None,
            description=json.dumps({"quantity": "depth", "unit": _MM}),
            software=SOFTWARE,
        )


def _number(depth_um: float) -> str:
    return "infinity" if math.isinf(depth_um) else f"{depth_um * 1e-3:.6g}"
