"""Photographs side by side, each with its name above it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from torch import Tensor

from nolens.camera import exposure_white, srgb_from_linear
from nolens.files.plot_reproduce import STYLE, save

_HEIGHT_IN, _TITLE_IN, _GAP_IN = 2.6, 0.32, 0.08
_WIDEST_IN = 9.0


@dataclass(frozen=True)
class Panel:
    """A picture and its name.

    Parameters
    ----------
    title
        Above it.
    radiance
        Linear, (1 or 3, height, width).
    white
        Radiance that is white; None: its own (`exposure_white`).
    """

    title: str
    radiance: Tensor
    white: float | None = None


def plot_pictures(path: Path, panels: tuple[Panel, ...]) -> None:
    """Draw photographs of one height in a row, with the sRGB curve.

    Parameters
    ----------
    path
        PNG to be written.
    panels
        From the left to the right.
    """
    ratios = [panel.radiance.shape[-1] / panel.radiance.shape[-2] for panel in panels]
    gaps = _GAP_IN * (len(panels) - 1)
    height = min(_HEIGHT_IN, (_WIDEST_IN - gaps) / sum(ratios))
    width = height * sum(ratios) + gaps
    with rc_context(STYLE):
        figure = Figure(figsize=(width, height + _TITLE_IN))
        left = 0.0
        for panel, ratio in zip(panels, ratios, strict=True):
            share = height / (height + _TITLE_IN)
            axes = figure.add_axes((left / width, 0.0, height * ratio / width, share))
            axes.imshow(_shown(panel), aspect="auto", interpolation="antialiased")
            axes.set_title(panel.title, fontsize=8.5, pad=4)
            axes.set_axis_off()
            left += height * ratio + _GAP_IN
        save(figure, path)


def _shown(panel: Panel) -> "np.ndarray[tuple[int, ...], np.dtype[np.float32]]":
    white = exposure_white(panel.radiance) if panel.white is None else panel.white
    picture = srgb_from_linear((panel.radiance / white).clamp(0, 1)).numpy()
    if len(picture) == 1:
        picture = picture.repeat(3, axis=0)
    return np.moveaxis(picture, 0, -1)
