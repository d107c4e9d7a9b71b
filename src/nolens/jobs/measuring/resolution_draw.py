"""Plots of a resolution."""

import math
from pathlib import Path

import numpy as np
from scipy import ndimage

from nolens.experiments.resolution import EdgeResolution, StarResolution, TwoPoints
from nolens.files.plot_resolution import (
    ARC_PERIODS,
    EdgeCurves,
    PairPanel,
    StarCurves,
    plot_edge,
    plot_star,
    plot_two_points,
)

_MOST_PANELS = 6
_SIDE_CELLS = 24


def draw_two_points(path: Path, found: TwoPoints) -> None:
    """Pictures of the points with the light through them, and the dips by separation."""
    order = sorted(range(len(found.seen)), key=lambda n: abs(found.dips[n] - found.threshold))
    panels = []
    for number in sorted(order[:_MOST_PANELS]):
        each = found.seen[number]
        picture = each.picture.numpy()
        light = np.clip(picture, 0, None)
        middle = [round(at) for at in ndimage.center_of_mass(light**2)]
        top, left = (max(0, at - _SIDE_CELLS // 2) for at in middle)
        panels.append(
            PairPanel(
                each.separation_deg, found.dips[number],
                picture[top : top + _SIDE_CELLS, left : left + _SIDE_CELLS],
                each.pair.at.numpy(), each.pair.trace.numpy(),
            )
        )  # fmt: skip
    plot_two_points(
        path, panels, separations_deg=found.separations_deg, dips=found.dips, noise=found.noise,
        threshold=found.threshold, resolved_deg=found.resolved.value,
        plus_minus_deg=found.resolved.plus_minus,
    )  # fmt: skip


def draw_star(path: Path, found: StarResolution) -> None:
    """The star, its contrast by frequency and direction, and the light along an arc."""
    star = found.star
    turn = math.radians(float(star.directions_deg[found.worst]))
    pairs = found.pairs_deg[found.worst].numpy()
    at_limit = float(np.interp(found.resolved_everywhere_deg, pairs, star.radii.numpy()))
    traces = {}
    for times in (1.0, 1.2, 1.5):
        radius = times * at_limit
        if radius > float(star.radii[-1]):
            continue
        periods = np.linspace(-ARC_PERIODS / 2, ARC_PERIODS / 2, 241)
        turns = turn + periods * (2 * math.pi / star.place.periods)
        places = [
            star.place.centre[0] - radius * np.sin(turns),
            star.place.centre[1] + radius * np.cos(turns),
        ]
        light = ndimage.map_coordinates(found.picture.values.numpy(), places, order=3)
        traces[float(np.interp(radius, star.radii.numpy(), pairs))] = light
    plot_star(
        path,
        StarCurves(
            found.picture.values.numpy(), star.place.centre, at_limit,
            (1 / found.pairs_deg).numpy(),
            star.contrast.numpy(), star.directions_deg.numpy(), found.resolved_deg, found.worst,
            found.threshold * star.wide, traces,
        ),
    )  # fmt: skip


def draw_edge(path: Path, found: EdgeResolution) -> None:
    """The edge, the light across it and the contrast by frequency."""
    response = found.response
    plot_edge(
        path,
        EdgeCurves(
            found.picture.values.numpy(), response.at.numpy() * found.cell_deg,
            response.spread.numpy(), response.frequencies.numpy() / found.cell_deg,
            response.transfer.numpy(),
            {level: found.per_deg(level) for level in (0.5, 0.1)},
        ),
    )  # fmt: skip
