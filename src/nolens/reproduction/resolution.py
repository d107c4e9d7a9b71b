"""Fig. 6a, b: two points at shrinking separation, and a Siemens star."""

from dataclasses import asdict, replace
from typing import Any

import torch

from nolens.evaluate import PointPair, ResolvedSeparation
from nolens.experiments.resolution import (
    FlatPicture,
    SeenPair,
    SolverSettings,
    StarResolution,
    TwoPoints,
    siemens_resolution,
    two_point_resolution,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.operators import Region
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
    region = Region.centred(64, 64, work.preview.cells)
    one = work.solve_seconds(region, size.point_iterations) / len(_channels(work))
    points = pairs * (2 * work.psf_seconds() + one)
    star = work.scene_seconds() + work.solve_seconds(region, size.iterations) / len(_channels(work))
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
            for each in found.seen
        ],
    }
    return Found(
        figures, {f"pair-{n}": each.picture[None].float() for n, each in enumerate(found.seen)}
    )


def read_points(found: Found) -> TwoPoints:
    """The pictures of two points, from what is stored of them."""
    figures = found.figures
    seen = tuple(
        SeenPair(
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
    found = siemens_resolution(
        bench, SCREEN_UM, STAR_DEG, periods=PERIODS, settings=settings, tick=tick
    )
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
