"""A contact sheet: labelled pictures side by side, with one white."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.files.pictures import screen_picture
from nolens.files.plots import plot_figure

_WIDTH_IN = 4.0
_DPI = 120
_COLUMNS = 3
_LABEL_IN = 0.6


@dataclass(frozen=True)
class SheetPicture:
    """A picture of a contact sheet.

    Parameters
    ----------
    label
        Above it.
    radiance
        Linear, (1 or 3, height, width).
    """

    label: str
    radiance: Tensor = field(repr=False)


def write_contact_sheet(
    path: str | Path, *, pictures: Sequence[SheetPicture], white: float
) -> None:
    """Draw pictures side by side, from left to right and then below.

    Parameters
    ----------
    pictures
        One or more.
    white
        Radiance that is white in all of them.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    columns = min(len(pictures), _COLUMNS)
    rows = math.ceil(len(pictures) / columns)
    tallest = max(each.radiance.shape[-2] / each.radiance.shape[-1] for each in pictures)
    size = columns * _WIDTH_IN, rows * (tallest * _WIDTH_IN + _LABEL_IN)
    with plot_figure(path, size, title_size="large", dpi=_DPI) as figure:
        for place, each in enumerate(pictures):
            axes = figure.add_subplot(rows, columns, place + 1)
            axes.imshow(np.asarray(screen_picture(_small(each.radiance), white)), cmap="gray")
            axes.set_title(each.label)
            axes.set_axis_off()
        figure.set_layout_engine("constrained", h_pad=0.08)


def _small(radiance: Tensor) -> Tensor:
    """A picture with no more pixels than its place on the sheet."""
    by = int(radiance.shape[-1] / (_WIDTH_IN * _DPI))
    if by < 2:
        return radiance
    means: Tensor = nnf.avg_pool2d(radiance[None].to(torch.float32), by, ceil_mode=True)[0]
    return means
