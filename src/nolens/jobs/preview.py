"""A picture of any file that can be read, to be looked at before it is worked on."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Frame, arrange_rgb, exposure_white
from nolens.camera.measurement import colour_planes
from nolens.capture import Levels
from nolens.errors import NolensError, OptionError
from nolens.files import (
    check_output,
    is_sequence,
    open_sequence,
    read_frame,
    read_picture,
    readable,
    write_png,
)
from nolens.jobs.fields import FilePath
from nolens.jobs.options import JobOptions, Written, check_apart
from nolens.jobs.reporter import Reporter

_LONG_SIDE = 1200
_JPEG = (".jpg", ".jpeg")


class PreviewOptions(JobOptions):
    """What a preview is made of.

    Attributes
    ----------
    path
        File to look at; of a folder or stack of frames, the first one.
    output
        PNG to write.
    """

    path: FilePath
    output: FilePath

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options by name.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("path"):
            raise OptionError("no path is given: name the file to look at")
        return cls.checked(given)

    @property
    def inputs(self) -> dict[str, Path]:
        """The file."""
        return {"file": self.path}

    @property
    def written(self) -> tuple[Written, ...]:
        """The picture."""
        return (Written("picture", self.output),)


@dataclass(frozen=True)
class PreviewOutcome:
    """What a preview came to.

    Parameters
    ----------
    picture
        Linear, (1 or 3, rows, columns), as it was written.
    summary
        Figures of the file, in values that JSON has.
    """

    picture: Tensor
    summary: dict[str, Any]


def preview(options: PreviewOptions, reporter: Reporter) -> PreviewOutcome:
    """Write a small sRGB picture of a raw frame or a picture, and say how bright it is.

    Parameters
    ----------
    options
        What to read, where to write.
    reporter
        Is told what it begins with.

    Raises
    ------
    NolensError
        If the file cannot be read, or is black everywhere.
    """
    check_output(options.output, (".png",))
    check_apart(options, options.inputs)
    reporter.advance("preview", 0.0)
    about: dict[str, Any] = {}
    if options.path.suffix.lower() in _JPEG:
        shown = read_picture(options.path).radiance
        size = shown.shape[-2:]
    else:
        frame = _frame(options.path)
        shown, size = _cells(frame), frame.counts.shape[-2:]
        levels = Levels.of(frame)
        about = {
            "histogram": {name: list(bins) for name, bins in levels.histogram.items()},
            "clipped_share": levels.clipped_share,
            "mosaic": frame.mosaic,
            "exposure_s": frame.exposure_s,
            "black": list(frame.black),
            "white": frame.white,
        }
    small = _small(shown)
    write_png(options.output, small, _white(small))
    return PreviewOutcome(
        small,
        {
            "picture": readable(options.output),
            "rows": size[0],
            "columns": size[1],
            **about,
            "outputs": [readable(options.output)],
        },
    )


def _frame(path: Path) -> Frame:
    return open_sequence(path).read(0) if is_sequence(path) else read_frame(path)


def _cells(frame: Frame) -> Tensor:
    """Linear values above black: a pixel for each 2×2 cell of a mosaic."""
    black = sum(frame.black) / len(frame.black)
    if frame.mosaic is None:
        return (arrange_rgb(frame.counts, frame.channels) - black).clamp_min(0)
    rows, columns = (count // 2 * 2 for count in frame.counts.shape[-2:])
    planes = colour_planes(frame.counts[0, :rows, :columns], frame.mosaic)
    means = [torch.stack(parts).mean(dim=0) for parts in planes.values()]
    return (torch.stack(means) - black).clamp_min(0)


def _small(values: Tensor) -> Tensor:
    share = _LONG_SIDE / max(values.shape[-2:])
    if share >= 1:
        return values
    size = [max(1, round(count * share)) for count in values.shape[-2:]]
    return nnf.interpolate(values[None].float(), size=size, mode="area")[0]


def _white(picture: Tensor) -> float:
    """White for it; of a frame without light, anything."""
    try:
        return exposure_white(picture)
    except NolensError:
        return 1.0
