"""A picture of any file that can be read, to be looked at before it is worked on."""

from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Frame, exposure_white
from nolens.camera.measurement import rgb_counts
from nolens.capture import Levels
from nolens.errors import NolensError
from nolens.files import is_sequence, open_sequence, read_frame, read_picture, readable, write_png
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Product, Run, job

_LONG_SIDE = 2048
_JPEG = (".jpg", ".jpeg")


class PreviewOptions(JobOptions):
    """Look at a raw frame or a picture, and see how bright it is."""

    path: Annotated[
        FilePath,
        Option(
            "Camera raw, a picture, or a folder or stack of frames, of which the first is shown.",
            needed="the file to look at",
            role="input",
            what="file",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "PNG to write.",
            needed="the PNG to write",
            role="output",
            what="picture",
            suffixes=(".png",),
            flag="-o",
        ),
    ]


@job
def write_preview(run: Run[PreviewOptions]) -> Product[Tensor]:
    """Write a small sRGB picture of a raw frame or a picture, and say how bright it is.

    Raises
    ------
    NolensError
        If the file cannot be read, or is black everywhere.
    """
    options = run.options
    run.reporter.advance("preview", 0.0)
    about: dict[str, Any] = {}
    if options.path.suffix.lower() in _JPEG:
        picture = read_picture(options.path).radiance
        size = picture.shape[-2:]
    else:
        frame = _frame(options.path)
        picture, size = _pixels(frame), frame.counts.shape[-2:]
        levels = Levels.of(frame)
        about = {
            "histogram": {name: list(bins) for name, bins in levels.histogram.items()},
            "clipped_fraction": levels.clipped_fraction,
            "mosaic": frame.mosaic,
            "exposure_s": frame.exposure_s,
            "black": list(frame.black),
            "white": frame.white,
        }
    small = _small(picture)
    figures = {"picture": readable(options.output), "rows": size[0], "columns": size[1], **about}
    write = partial(write_png, radiance=small, white=_white(small))
    return Product(small, figures, {options.output: write})


def _frame(path: Path) -> Frame:
    return open_sequence(path).read(0) if is_sequence(path) else read_frame(path)


def _pixels(frame: Frame) -> Tensor:
    """Linear values above black: a pixel for each 2×2 superpixel of a mosaic."""
    black = sum(frame.black) / len(frame.black)
    return (rgb_counts(frame) - black).clamp_min(0)


def _small(values: Tensor) -> Tensor:
    factor = _LONG_SIDE / max(values.shape[-2:])
    if factor >= 1:
        return values
    size = [max(1, round(count * factor)) for count in values.shape[-2:]]
    return nnf.interpolate(values[None].float(), size=size, mode="area")[0]


def _white(picture: Tensor) -> float:
    """White for it; of a frame without light, anything."""
    try:
        return exposure_white(picture)
    except NolensError:
        return 1.0
