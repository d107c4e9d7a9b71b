"""What plots of resolution have in common."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nolens.files.save_plot import save_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

ACCENT, WORST, GUIDE = "#2a7f62", "#c23b2e", "0.45"
"""Colours of what is measured, of its worst part, and of lines to read it by."""
_WHITE_SHARE = 99.5


def white_level(picture: NDArray[np.floating[Any]]) -> float:
    """Value that is drawn white: nearly the greatest."""
    return float(np.percentile(picture, _WHITE_SHARE))


def show_picture(
    axes: "Axes", picture: NDArray[np.floating[Any]], white: float | None = None
) -> None:
    """Draw a picture of a target in grey, without axes."""
    axes.imshow(
        picture,
        cmap="gray",
        vmin=0,
        vmax=white_level(picture) if white is None else white,
        interpolation="nearest",
    )
    axes.set_axis_off()


@contextmanager
def resolution_figure(path: Path, size: tuple[float, float]) -> Iterator["Figure"]:
    """Draw on a figure that is written at the end.

    Parameters
    ----------
    path
        PNG to be written.
    size
        Of the figure, (width, height) in inches.
    """
    # It takes a third of a second, which other commands need not wait.
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context(
        {
            "font.size": 9,
            "axes.titlesize": 9,
            "axes.spines.top": False,
            "axes.spines.right": False,
        }
    ):
        figure = Figure(figsize=size, layout="constrained")
        yield figure
        save_plot(figure, path)
