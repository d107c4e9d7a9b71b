"""How plots are drawn and written: on white, and for pages with a dark theme on dark ground too.

matplotlib takes a third of a second to load, which a command without a plot need not wait: it is
imported where something is drawn.
"""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from nolens.files.atomic import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

STYLE: dict[Any, Any] = {"font.size": 9, "axes.spines.top": False, "axes.spines.right": False}
"""Settings of all plots."""
ACCENT, WORST, GUIDE = "#2a7f62", "#c23b2e", "0.45"
"""Colours of what is measured, of its worst part, and of lines to read it by."""
_WHITE_PERCENTILE = 99.5
_GROUND = "#191d20"
_GREY = 0.15
_LEAST_LIGHT = 0.66
_dark_plots: ContextVar[list[bytes] | None] = ContextVar("dark_plots", default=None)


@contextmanager
def dark_plots() -> Iterator[list[bytes]]:
    """Every plot that is written in the block is drawn for a dark page too.

    Yields
    ------
    list
        Those as PNG, in the order of the plots.
    """
    drawn: list[bytes] = []
    token = _dark_plots.set(drawn)
    try:
        yield drawn
    finally:
        _dark_plots.reset(token)


def _save(figure: "Figure", path: str | Path, dpi: int) -> None:
    """Write a plot as PNG, and recolour and write it once more where `dark_plots` asks for it.

    The bytes depend on nothing but what is drawn.
    """
    figure.savefig(path, format="png", dpi=dpi, metadata={"Software": None})
    drawn = _dark_plots.get()
    if drawn is not None:
        _darken(figure)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=dpi, facecolor=_GROUND)
        drawn.append(buffer.getvalue())


def _darken(figure: "Figure") -> None:
    """Exchange light and dark in all that is drawn; pictures stay, and what is white on them."""
    from matplotlib.collections import Collection
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch
    from matplotlib.text import Text

    for each in figure.findobj():
        if isinstance(each, Text):
            if each.get_bbox_patch() is None:  # In a box it stands out already.
                each.set_color(_dark(each.get_color()))
        elif isinstance(each, Line2D):
            each.set(
                color=_dark(each.get_color()),
                markerfacecolor=_dark(each.get_markerfacecolor()),
                markeredgecolor=_dark(each.get_markeredgecolor()),
            )
        elif isinstance(each, Patch):
            face = each.get_facecolor()
            each.set_edgecolor(_dark(each.get_edgecolor()))
            each.set_facecolor(_GROUND if _is_white(face) else _dark(face))
        elif isinstance(each, Collection):
            if each.get_array() is None:  # Else its colours stand for values.
                each.set_facecolor([_dark(colour) for colour in each.get_facecolor()])
            each.set_edgecolor([_dark(colour) for colour in each.get_edgecolor()])


def _dark(colour: Any) -> Any:
    """A colour that stands out from the dark ground as this one did from white; white stays."""
    import colorsys

    from matplotlib.colors import to_rgba

    if isinstance(colour, str) and colour in ("none", "auto"):
        return colour
    red, green, blue, alpha = to_rgba(colour)
    if _is_white((red, green, blue, alpha)):
        return colour
    hue, light, saturation = colorsys.rgb_to_hls(red, green, blue)
    if saturation < _GREY:
        light = 0.92 - 0.8 * light
    return (
        *colorsys.hls_to_rgb(hue, max(light, _LEAST_LIGHT * (saturation >= _GREY)), saturation),
        alpha,
    )


def _is_white(colour: Any) -> bool:
    return bool(colour[3] > 0 and min(colour[:3]) > 0.98)


def white_level(picture: NDArray[np.floating[Any]]) -> float:
    """Value that is drawn white: nearly the greatest."""
    return float(np.percentile(picture, _WHITE_PERCENTILE))


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
def plot_figure(
    path: str | Path,
    size: tuple[float, float],
    *,
    title_size: float | str = 9,
    dpi: int = 120,
    layout: Literal["constrained"] | None = "constrained",
) -> Iterator["Figure"]:
    """Draw on a figure that is written as PNG at the end of the block.

    Parameters
    ----------
    size
        Of the figure, (width, height) in inches.
    title_size
        Of the titles of its parts, as matplotlib takes it.
    dpi
        Pixels per inch.
    layout
        What places its parts; None leaves that to the caller.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure

    with mpl.rc_context({**STYLE, "axes.titlesize": title_size}):
        figure = Figure(figsize=size, layout=layout)
        yield figure
        with atomic_write(path) as temporary:
            _save(figure, temporary, dpi)
