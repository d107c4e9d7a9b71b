"""Fig. 6a and b: two points and a Siemens star."""

import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from functools import partial
from typing import Any

import torch

from nolens.evaluate import (
    FlatPicture,
    ObservedPair,
    PointPair,
    ResolvedSeparation,
    StarResolution,
    TwoPoints,
    siemens_star,
    star_square_deg,
)
from nolens.experiments.resolution import SolverSettings, screen_picture, two_point_resolution
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files.plot_resolution import draw_star, draw_two_points
from nolens.operators import Region
from nolens.reproduction.draft import Draft, Drawn, empty, refusal
from nolens.reproduction.rows import Row
from nolens.reproduction.steps import Found, Step, Tick
from nolens.reproduction.workbench import SCREEN_UM, TAU, Workbench

POINTS_UM = 180e3
PERIODS = 36
STAR_DEG = 20.0
_EXPECTED_PAIRS = 8


def steps(work: Workbench) -> tuple[Step, ...]:
    """Two points at 180 mm, a star on the screen at 300 mm."""
    size = work.size
    pairs = _EXPECTED_PAIRS * size.point_draws
    region = Region.centred(64, 64, work.preview.shape)
    one = work.solve_work(region, size.point_iterations) / len(_channels(work))
    points = pairs * (2 * work.psf_work() + one)
    star = work.scene_work() + work.solve_work(region, size.iterations) / len(_channels(work))
    return (
        Step(
            "two-points",
            "fig. 6a: two points",
            work.parameters(distance_um=POINTS_UM, tau=TAU),
            points,
            lambda tick: _points(work, tick),
        ),
        Step(
            "siemens",
            "fig. 6b: a Siemens star",
            work.parameters(periods=PERIODS, angle_deg=STAR_DEG, tau=TAU),
            star,
            lambda tick: _star(work, tick),
        ),
    )


def _channels(work: Workbench) -> tuple[str, ...]:
    return work.opened.camera.sensor.channels


def _points(work: Workbench, tick: Tick) -> Found:
    """Dips by separation, with a picture of each."""
    settings = SolverSettings(work.size.point_iterations, TAU, seed=work.seed)
    found = two_point_resolution(
        work.bench, POINTS_UM, draws=work.size.point_draws, settings=settings, tick=tick
    )
    figures: dict[str, Any] = {
        "separations_deg": found.separations_deg,
        "dips": found.dips,
        "noise": found.noise,
        "threshold": found.threshold,
        "resolved": asdict(found.resolved),
        "seen": [
            {
                "separation_deg": each.separation_deg,
                "dip": each.pair.dip,
                "separation": each.pair.separation,
                "direction_deg": each.pair.direction_deg,
                "at": each.pair.at.tolist(),
                "trace": each.pair.trace.tolist(),
            }
            for each in found.pairs
        ],
    }
    return Found(
        figures, {f"pair-{n}": each.picture[None].float() for n, each in enumerate(found.pairs)}
    )


def read_points(found: Found) -> TwoPoints:
    """The pictures of two points, from what is stored of them."""
    figures = found.figures
    seen = tuple(
        ObservedPair(
            each["separation_deg"],
            PointPair(
                each["dip"],
                each["separation"],
                each["direction_deg"],
                torch.tensor(each["at"]),
                torch.tensor(each["trace"]),
            ),
            found.arrays[f"pair-{number}"][0],
        )
        for number, each in enumerate(figures["seen"])
    )
    return TwoPoints(
        tuple(figures["separations_deg"]),
        tuple(figures["dips"]),
        tuple(figures["noise"]),
        ResolvedSeparation(**figures["resolved"]),
        figures["threshold"],
        seen,
    )


def _star(work: Workbench, tick: Tick) -> Found:
    """The picture of the star, and what is resolved in it."""
    settings = SolverSettings(work.size.iterations, TAU, seed=work.seed)
    # A star this small needs no more PSFs than change over it.
    bench: VirtualExperiment = replace(work.bench, field_points=3)
    target = partial(siemens_star, periods=PERIODS)
    square_deg = star_square_deg(STAR_DEG)
    picture = screen_picture(bench, target, square_deg, SCREEN_UM, settings, tick)
    found = StarResolution.of(picture, periods=PERIODS)
    figures: dict[str, Any] = {
        "resolved_deg": found.resolved_everywhere_deg,
        "plus_minus_deg": found.plus_minus_deg[found.worst],
        "by_direction_deg": dict(
            zip(map(str, found.star.directions_deg.tolist()), found.resolved_deg, strict=True)
        ),
        "tangent": found.picture.tangent,
        "axis": list(found.picture.axis),
    }
    return Found(figures, {"picture": found.picture.values[None].float()})


def read_star(found: Found) -> StarResolution:
    """The star, from what is stored of it."""
    row, column = found.figures["axis"]
    picture = FlatPicture(
        found.arrays["picture"][0].double(), found.figures["tangent"], (row, column)
    )
    return StarResolution.of(picture, periods=PERIODS)


def two_points(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """The smallest angle between two points with a dip between them."""
    title = "Fig. 6a: two points"
    reason = refusal(found, ("two-points",))
    if reason is not None:
        return empty("two-points", title, ("two points",), reason)
    points = read_points(found["two-points"])
    value = points.resolved.value
    off = points.resolved.plus_minus
    text = "–" if value is None else f"{value:.2f}°" + ("" if off is None else f" ± {off:.2f}°")
    twin = work.preview
    cell_deg = _cell_deg(work)
    row = Row(
        "two points",
        value,
        text,
        f"Rayleigh's criterion, a dip of {100 * points.threshold:.1f} %, in pictures of two points "
        f"at {POINTS_UM * 1e-3:g} mm, {work.size.point_draws} of each separation with other noise, "
        f"{work.size.point_iterations} iterations. A scene of two points is what a sparse, "
        f"non-negative solver does best, and its model is exact here: a cell of {twin.pixel_um:g} "
        f"µm sees {cell_deg:.2f}°. The paper's LEDs have a size, its "
        "PSF is a captured one, and it moves LEDs in steps that it does not give.",
        sized=True,
    )
    caption = (
        "Reconstructions of two points, the light along the line through them, and the dip by "
        "separation."
    )
    drawn = Drawn("two-points", caption, partial(draw_two_points, points), 150.0)
    return Draft("two-points", title, (), (drawn,), (row,))


def siemens(work: Workbench, found: Mapping[str, Found]) -> Draft:
    """The smallest pair of spokes that is resolved in all directions."""
    title = "Fig. 6b: a Siemens star"
    reason = refusal(found, ("siemens",))
    if reason is not None:
        return empty("siemens", title, ("siemens",), reason)
    figures = found["siemens"].figures
    star = read_star(found["siemens"])
    value = figures["resolved_deg"]
    best = min(figures["by_direction_deg"].values())
    row = Row(
        "siemens",
        value,
        f"{value:.2f}° ± {figures['plus_minus_deg']:.2f}°",
        f"Angle of a bright spoke and the dark one beside it where the contrast falls to "
        f"{100 * star.threshold:.0f} % of that of wide spokes, in the worst of all directions "
        f"(in the best, {best:.2f}°); one spoke alone is half of it. {PERIODS} pairs of spokes "
        f"filling {STAR_DEG:g}° at 300 mm. The paper says neither which of the two angles it "
        "means nor what contrast counts, so the ratio is no better than a factor of two. Flat "
        "bright and dark spokes are what total variation does best: a scene of fine texture is "
        "resolved less well.",
        sized=True,
    )
    caption = "The star as it is reconstructed, its contrast by frequency and direction."
    drawn = Drawn("siemens", caption, partial(draw_star, star), 165.0)
    return Draft("siemens", title, (), (drawn,), (row,))


def _cell_deg(work: Workbench) -> float:
    twin = work.preview
    return math.degrees(math.atan(twin.pixel_um / twin.stack().reduced_um))
