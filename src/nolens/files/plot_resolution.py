"""Plots of resolution: two points, Siemens star and slanted edge."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nolens.files.save_plot import save_plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_Array = NDArray[np.float64]
_ACCENT, _WORST, _GUIDE = "#2a7f62", "#c23b2e", "0.45"
_WHITE_SHARE = 99.5
_ARC_STEP = 1.15
ARC_PERIODS = 4
"""Pairs of spokes that a trace along an arc shows."""


@dataclass(frozen=True)
class PairPanel:
    """Two points at one separation.

    Parameters
    ----------
    separation_deg, dip
        Angle between them, and how deep the dip is.
    picture
        (height, width).
    at, trace
        Places along the line through them in cells, and the light there.
    """

    separation_deg: float
    dip: float
    picture: _Array
    at: _Array
    trace: _Array


@dataclass(frozen=True)
class StarCurves:
    """What is drawn of a Siemens star.

    Parameters
    ----------
    picture
        (height, width).
    centre
        Row and column.
    radius
        In cells, from which on all is resolved.
    cycles_per_deg, contrast
        By direction, (directions, radii).
    directions_deg
        Of the spokes.
    resolved_deg
        Smallest resolved pair of spokes in each direction.
    worst
        Number of the direction in which least is resolved.
    needed
        Contrast at which spokes count as resolved.
    traces
        Light along arcs of the worst direction, by the angle of a pair of spokes there.
    """

    picture: _Array
    centre: tuple[float, float]
    radius: float
    cycles_per_deg: _Array
    contrast: _Array
    directions_deg: _Array
    resolved_deg: Sequence[float]
    worst: int
    needed: float
    traces: Mapping[float, _Array]


@dataclass(frozen=True)
class EdgeCurves:
    """What is drawn of an edge.

    Parameters
    ----------
    picture
        (height, width).
    at_deg, spread
        Angles across the edge, and the light there.
    cycles_per_deg, contrast
        Of the transfer.
    marks
        Frequency by contrast; None where it is not reached.
    """

    picture: _Array
    at_deg: _Array
    spread: _Array
    cycles_per_deg: _Array
    contrast: _Array
    marks: Mapping[float, float | None]


def plot_two_points(
    path: Path,
    panels: Sequence[PairPanel],
    *,
    separations_deg: Sequence[float],
    dips: Sequence[float],
    noise: Sequence[float],
    threshold: float,
    resolved_deg: float | None,
    plus_minus_deg: float | None,
) -> None:
    """Draw pictures of two points, the light through them, and the dips by separation.

    Parameters
    ----------
    path
        PNG to be written.
    panels
        Some of the separations.
    separations_deg, dips, noise
        All of them: angle, dip and its standard error.
    threshold
        Dip that counts as resolved.
    resolved_deg, plus_minus_deg
        The result, if there is one.
    """
    count = len(panels)
    with _figure(path, (max(2.0 * count, 6.0), 7.0)) as figure:
        grid = figure.add_gridspec(3, count, height_ratios=[3, 2, 4])
        for number, panel in enumerate(panels):
            above, below = (figure.add_subplot(grid[row, number]) for row in (0, 1))
            _show(above, panel.picture, white=float(panel.picture.max()))
            above.set_title(f"{panel.separation_deg:.3g}°, dip {100 * panel.dip:.0f} %")
            below.plot(panel.at, panel.trace, color=_ACCENT)
            below.axhline(1 - threshold, color=_GUIDE, linewidth=0.8, linestyle=":")
            below.set_xlabel("cells")
            below.set_ylim(-0.05, 1.1)
            below.set_ylabel("light" if number == 0 else "")
        axes = figure.add_subplot(grid[2, :])
        axes.axhline(100 * threshold, color=_GUIDE, linewidth=0.8, linestyle=":")
        title = "dip between the points"
        if resolved_deg is not None and plus_minus_deg is not None:
            axes.axvspan(
                resolved_deg - plus_minus_deg,
                resolved_deg + plus_minus_deg,
                color=_ACCENT,
                alpha=0.15,
                linewidth=0,
            )
            axes.axvline(resolved_deg, color=_ACCENT, linewidth=0.9)
            title = f"resolved from {resolved_deg:.3f}° ± {plus_minus_deg:.3f}° on"
        axes.errorbar(
            separations_deg,
            [100 * dip for dip in dips],
            [100 * each for each in noise],
            color="black",
            marker="o",
            markersize=4,
            linewidth=1,
            capsize=2,
        )
        axes.set_xlabel("separation, degrees")
        axes.set_ylabel("dip, %")
        axes.set_ylim(-4, 104)
        axes.set_title(f"{title}; dotted: a dip of {100 * threshold:.1f} %")


def plot_star(path: Path, curves: StarCurves) -> None:
    """Draw a Siemens star, its contrast by frequency and direction, and the light along arcs.

    Parameters
    ----------
    path
        PNG to be written.
    curves
        What to draw.
    """
    worst = curves.worst
    with _figure(path, (10.5, 8.4)) as figure:
        from matplotlib.patches import Circle

        places = figure.subplot_mosaic(
            [["picture", "contrast"], ["arc", "round"]], per_subplot_kw={"round": {"polar": True}}
        )
        _show(places["picture"], curves.picture)
        places["picture"].add_patch(
            Circle(curves.centre[::-1], curves.radius, fill=False, color=_WORST, linewidth=1.2)
        )
        places["picture"].set_title(
            f"circle: spokes of {curves.resolved_deg[worst]:.3f}° a pair, resolved from there on"
        )
        axes = places["contrast"]
        for number, direction in enumerate(curves.directions_deg):
            is_worst = number == worst
            axes.plot(
                curves.cycles_per_deg[number],
                curves.contrast[number],
                color=_WORST if is_worst else _ACCENT,
                linewidth=1.6 if is_worst else 0.8,
                alpha=1.0 if is_worst else 0.5,
                zorder=3 if is_worst else 2,
                label=f"spokes at {direction:g}° (worst)"
                if is_worst
                else "other directions"
                if number == (worst + 1) % len(curves.directions_deg)
                else None,
            )
        axes.axhline(curves.needed, color=_GUIDE, linewidth=0.8, linestyle=":")
        axes.set_xlabel("cycles to the degree")
        axes.set_ylabel("contrast")
        axes.set_ylim(bottom=0)
        axes.set_title(f"dotted: {curves.needed:.3g}, that counts as resolved")
        axes.legend(frameon=False)
        _arcs(places["arc"], curves)
        _round(places["round"], curves)


def plot_edge(path: Path, curves: EdgeCurves) -> None:
    """Draw an edge, the light across it and the contrast by frequency.

    Parameters
    ----------
    path
        PNG to be written.
    curves
        What to draw.
    """
    with _figure(path, (12.0, 3.8)) as figure:
        picture, spread, contrast = figure.subplots(1, 3)
        _show(picture, curves.picture)
        picture.set_title("picture")
        spread.plot(curves.at_deg, curves.spread, color=_ACCENT)
        spread.set_xlabel("degrees from the edge")
        spread.set_ylabel("light")
        spread.set_title("across the edge")
        contrast.plot(curves.cycles_per_deg, curves.contrast, color=_ACCENT)
        for level, frequency in curves.marks.items():
            contrast.axhline(level, color=_GUIDE, linewidth=0.8, linestyle=":")
            if frequency is not None:
                contrast.plot([frequency], [level], "o", color=_WORST, markersize=5)
                contrast.annotate(
                    f"{frequency:.2f}/deg",
                    (frequency, level),
                    xytext=(6, 5),
                    textcoords="offset points",
                )
        contrast.set_xlabel("cycles to the degree")
        contrast.set_ylabel("contrast")
        contrast.set_ylim(bottom=0)
        contrast.set_title("modulation transfer")


def _arcs(axes: "Axes", curves: StarCurves) -> None:
    """Light along arcs of the worst direction, one below the other."""
    white = float(np.percentile(curves.picture, _WHITE_SHARE))
    for number, light in enumerate(curves.traces.values()):
        periods = np.linspace(-ARC_PERIODS / 2, ARC_PERIODS / 2, len(light))
        level = -_ARC_STEP * number
        axes.axhline(level, color=_GUIDE, linewidth=0.5)
        axes.plot(periods, light / white + level, color=_WORST if number == 0 else _ACCENT)
    axes.set_xlabel("pairs of spokes")
    levels = [-_ARC_STEP * number for number in range(len(curves.traces))]
    axes.set_yticks(levels, [f"{pair_deg:.3f}°" for pair_deg in curves.traces])
    axes.set_ylabel("light, by the angle of a pair")
    turn = float(curves.directions_deg[curves.worst])
    axes.set_title(f"light along arcs about {turn:g}°, each above its line")


def _round(axes: "Axes", curves: StarCurves) -> None:
    """The smallest resolved pair of spokes around the circle."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    turns = np.radians(np.append(curves.directions_deg, curves.directions_deg[0]))
    angles = np.append(curves.resolved_deg, curves.resolved_deg[0])
    axes.plot(turns, angles, color=_ACCENT, marker="o", markersize=4)
    axes.plot(turns[curves.worst], angles[curves.worst], "o", color=_WORST, markersize=7)
    axes.set_ylim(0, 1.2 * float(angles.max()))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    assert isinstance(axes, PolarAxes)
    axes.set_rlabel_position(22.5)
    axes.set_title("smallest resolved pair by direction of the spokes, degrees")


def _show(axes: "Axes", picture: _Array, white: float | None = None) -> None:
    if white is None:
        white = float(np.percentile(picture, _WHITE_SHARE))
    axes.imshow(picture, cmap="gray", vmin=0, vmax=white, interpolation="nearest")
    axes.set_axis_off()


@contextmanager
def _figure(path: Path, size: tuple[float, float]) -> Iterator["Figure"]:
    """A figure that is written at the end."""
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
