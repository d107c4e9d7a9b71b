"""How plots are written: on white, and for pages with a dark theme once more on a dark ground."""

import io
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_GROUND = "#191d20"
_GREY = 0.15
_LEAST_LIGHT = 0.66
_DPI = 120
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


def save_plot(figure: "Figure", path: str | Path) -> None:
    """Write a plot as PNG.

    Parameters
    ----------
    figure
        The plot, as it is drawn on white. Where `dark_plots` asks for it, it is recoloured.
    path
        The file to write.
    """
    figure.savefig(path, format="png", dpi=_DPI)
    drawn = _dark_plots.get()
    if drawn is not None:
        _darken(figure)
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=_DPI, facecolor=_GROUND)
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
