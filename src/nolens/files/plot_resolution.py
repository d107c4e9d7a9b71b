"""Plots of resolution: two points, a Siemens star, a slanted edge."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import ndimage

from nolens.files.plots import ACCENT, GUIDE, WORST, plot_figure, show_picture, white_level

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from nolens.evaluate import EdgeResolution, StarResolution, TwoPoints

_LEVELS = (0.5, 0.1)
"""Contrasts that are marked."""
_MOST_PANELS = 6
_PANEL_PIXELS = 24
"""Pictures of two points, and pixels along the side of each."""
_ARC_STEP = 1.15
_ARC_PERIODS = 4
_ARC_RADII = (1.0, 1.2, 1.5)
"""Distance of the traces, pairs of spokes in each, radii in those of the resolved ones."""


def draw_two_points(points: "TwoPoints", path: Path) -> None:
    """Draw the points with the light through them, and the dips by separation."""
    order = sorted(range(len(points.pairs)), key=lambda n: abs(points.dips[n] - points.threshold))
    panels = sorted(order[:_MOST_PANELS])
    with plot_figure(path, (max(2.0 * len(panels), 6.0), 7.0)) as figure:
        grid = figure.add_gridspec(3, len(panels), height_ratios=[3, 2, 4])
        for place, number in enumerate(panels):
            above, below = (figure.add_subplot(grid[row, place]) for row in (0, 1))
            each = points.pairs[number]
            picture = each.picture.numpy()
            light = np.clip(picture, 0, None)
            middle = [round(at) for at in ndimage.center_of_mass(light**2)]
            top, left = (max(0, at - _PANEL_PIXELS // 2) for at in middle)
            picture = picture[top : top + _PANEL_PIXELS, left : left + _PANEL_PIXELS]
            show_picture(above, picture, white=float(picture.max()))
            above.set_title(f"{each.separation_deg:.3g}°, dip {100 * points.dips[number]:.0f} %")
            below.plot(each.pair.at.numpy(), each.pair.trace.numpy(), color=ACCENT)
            below.axhline(1 - points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
            below.set_xlabel("pixels")
            below.set_ylim(-0.05, 1.1)
            below.set_ylabel("light" if place == 0 else "")
        axes = figure.add_subplot(grid[2, :])
        axes.axhline(100 * points.threshold, color=GUIDE, linewidth=0.8, linestyle=":")
        title = "dip between the points"
        angle, off = points.resolved.value, points.resolved.plus_minus
        if angle is not None and off is not None:
            axes.axvspan(angle - off, angle + off, color=ACCENT, alpha=0.15, linewidth=0)
            axes.axvline(angle, color=ACCENT, linewidth=0.9)
            title = f"resolved from {angle:.3f}° ± {off:.3f}° on"
        axes.errorbar(
            points.separations_deg,
            [100 * dip for dip in points.dips],
            [100 * each for each in points.noise],
            color="black",
            marker="o",
            markersize=4,
            linewidth=1,
            capsize=2,
        )
        axes.set_xlabel("separation, degrees")
        axes.set_ylabel("dip, %")
        axes.set_ylim(-4, 104)
        axes.set_title(f"{title}; dotted: a dip of {100 * points.threshold:.1f} %")


def draw_star(resolution: "StarResolution", path: Path) -> None:
    """Draw the star, its contrast by frequency and direction, and the light along arcs."""
    star, worst = resolution.star, resolution.worst
    with plot_figure(path, (10.5, 8.4)) as figure:
        from matplotlib.patches import Circle

        places = figure.subplot_mosaic(
            [["picture", "contrast"], ["arc", "round"]], per_subplot_kw={"round": {"polar": True}}
        )
        show_picture(places["picture"], resolution.picture.values.numpy())
        row, column = star.place.centre
        radius = _resolved_radius(resolution)
        places["picture"].add_patch(
            Circle((column, row), radius, fill=False, color=WORST, linewidth=1.2)
        )
        places["picture"].set_title(
            f"circle: spokes of {resolution.resolved_everywhere_deg:.3f}° a pair, resolved from "
            "there on"
        )
        axes = places["contrast"]
        directions = star.directions_deg.tolist()
        for number, direction in enumerate(directions):
            is_worst = number == worst
            axes.plot(
                (1 / resolution.pairs_deg[number]).numpy(),
                star.contrast[number].numpy(),
                color=WORST if is_worst else ACCENT,
                linewidth=1.6 if is_worst else 0.8,
                alpha=1.0 if is_worst else 0.5,
                zorder=3 if is_worst else 2,
                label=f"spokes at {direction:g}° (worst)"
                if is_worst
                else "other directions"
                if number == (worst + 1) % len(directions)
                else None,
            )
        needed = resolution.threshold * star.wide
        axes.axhline(needed, color=GUIDE, linewidth=0.8, linestyle=":")
        axes.set_xlabel("cycles to the degree")
        axes.set_ylabel("contrast")
        axes.set_ylim(bottom=0)
        axes.set_title(f"dotted: {needed:.3g}, that counts as resolved")
        axes.legend(frameon=False)
        _arcs(places["arc"], resolution)
        _round(places["round"], resolution)


def _resolved_radius(resolution: "StarResolution") -> float:
    """In pixels, from which on all is resolved."""
    pairs = resolution.pairs_deg[resolution.worst].numpy()
    radii = resolution.star.radii.numpy()
    return float(np.interp(resolution.resolved_everywhere_deg, pairs, radii))


def _arcs(axes: "Axes", resolution: "StarResolution") -> None:
    """Light along arcs of the worst direction, one below the other."""
    star, picture = resolution.star, resolution.picture.values.numpy()
    direction_deg = float(star.directions_deg[resolution.worst])
    pairs, radii = resolution.pairs_deg[resolution.worst].numpy(), star.radii.numpy()
    periods = np.linspace(-_ARC_PERIODS / 2, _ARC_PERIODS / 2, 241)
    turns = math.radians(direction_deg) + periods * (2 * math.pi / star.place.periods)
    white = white_level(picture)
    labels: dict[float, str] = {}
    for number, times in enumerate(_ARC_RADII):
        radius = times * _resolved_radius(resolution)
        if radius > float(radii[-1]):
            continue
        row, column = star.place.centre
        places = [row - radius * np.sin(turns), column + radius * np.cos(turns)]
        light = ndimage.map_coordinates(picture, places, order=3)
        level = -_ARC_STEP * number
        labels[level] = f"{float(np.interp(radius, radii, pairs)):.3f}°"
        axes.axhline(level, color=GUIDE, linewidth=0.5)
        axes.plot(periods, light / white + level, color=WORST if number == 0 else ACCENT)
    axes.set_xlabel("pairs of spokes")
    axes.set_yticks(list(labels), list(labels.values()))
    axes.set_ylabel("light, by the angle of a pair")
    axes.set_title(f"light along arcs about {direction_deg:g}°, each above its line")


def _round(axes: "Axes", resolution: "StarResolution") -> None:
    """The smallest resolved pair of spokes around the circle."""
    from matplotlib.projections.polar import PolarAxes
    from matplotlib.ticker import MaxNLocator

    directions, worst = resolution.star.directions_deg.numpy(), resolution.worst
    turns = np.radians(np.append(directions, directions[0]))
    angles = np.append(resolution.resolved_deg, resolution.resolved_deg[0])
    axes.plot(turns, angles, color=ACCENT, marker="o", markersize=4)
    axes.plot(turns[worst], angles[worst], "o", color=WORST, markersize=7)
    axes.set_ylim(0, 1.2 * float(angles.max()))
    axes.yaxis.set_major_locator(MaxNLocator(4))
    assert isinstance(axes, PolarAxes)
    axes.set_rlabel_position(22.5)
    axes.set_title("smallest resolved pair by direction of the spokes, degrees")


def draw_edge(edge: "EdgeResolution", path: Path) -> None:
    """Draw the edge, the light across it and the contrast by frequency, as the PNG of a path."""
    response = edge.response
    with plot_figure(path, (12.0, 3.8)) as figure:
        picture, spread, contrast = figure.subplots(1, 3)
        show_picture(picture, edge.picture.values.numpy())
        picture.set_title("picture")
        spread.plot(response.at.numpy() * edge.pixel_deg, response.spread.numpy(), color=ACCENT)
        spread.set_xlabel("degrees from the edge")
        spread.set_ylabel("light")
        spread.set_title("across the edge")
        frequencies = response.frequencies.numpy() / edge.pixel_deg
        contrast.plot(frequencies, response.transfer.numpy(), color=ACCENT)
        for level in _LEVELS:
            contrast.axhline(level, color=GUIDE, linewidth=0.8, linestyle=":")
            frequency = edge.per_deg(level)
            if frequency is not None:
                contrast.plot([frequency], [level], "o", color=WORST, markersize=5)
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
