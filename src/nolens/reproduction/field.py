"""Fig. 6c, d: PSFs from the side against the central one, and a grid of dots."""

import math
from dataclasses import asdict, replace
from typing import Any

from nolens.errors import NolensError
from nolens.experiments.dot_grid import dot_grid
from nolens.experiments.off_axis import off_axis
from nolens.operators import Region
from nolens.reproduction.steps import Found, Step, Tick, within
from nolens.reproduction.workbench import PINHOLE_UM, SCREEN_UM, Workbench

PAPERS_PITCH_UM = 2300.0
_PAPERS_REACH_DEG = 10.0
PITCH_DEG = 3.0
_STEP_DEG = 2.5
_LARGEST_DEG = 50.0


def steps(work: Workbench) -> tuple[Step, ...]:
    """Correlation by angle, and the dots."""
    angles = angles_deg(work)
    side = round(2 * _reach_cells(work))
    region = Region.centred(side, side, work.preview.cells)
    scene = work.scene_seconds(work.size.dot_field_points)
    return (
        Step(
            "off-axis",
            "fig. 6c: PSFs from the side",
            work.parameters(angles_deg=angles),
            (len(angles) + 1) * work.psf_seconds(),
            lambda tick: _correlated(work, tick),
        ),
        Step(
            "dots",
            "fig. 6d: a grid of dots",
            work.parameters(pitch_deg=PITCH_DEG),
            1.3 * (scene + work.solve_seconds(region, work.size.iterations)),
            lambda tick: _dots(work, tick),
        ),
    )


def angles_deg(work: Workbench) -> list[float]:
    """To the right, up to where the model ends."""
    step = _STEP_DEG * work.size.angle_steps
    return [number * step for number in range(1, int(_LARGEST_DEG / step) + 1)]


def _reach_cells(work: Workbench) -> float:
    twin = work.preview
    return math.tan(math.radians(work.size.dot_reach_deg)) * twin.stack().reduced_um / twin.cell_um


def _correlated(work: Workbench, tick: Tick) -> Found:
    """Correlation, overlap and light of a point source at every angle."""
    found = off_axis(
        work.bench,
        angles_deg(work),
        distance_um=SCREEN_UM,
        diameter_um=PINHOLE_UM,
        seed=work.seed,
        tick=tick,
    )
    return Found({"off_axis": [asdict(each) for each in found]})


def _dots(work: Workbench, tick: Tick) -> Found:
    """A grid as far as the model goes; and the paper's own, fine one in the middle of the field."""
    bench = replace(work.bench, field_points=work.size.dot_field_points)
    pitch_um = math.tan(math.radians(PITCH_DEG)) * SCREEN_UM
    wide = dot_grid(
        bench,
        pitch_um=pitch_um,
        distance_um=SCREEN_UM,
        reach_deg=work.size.dot_reach_deg,
        iterations=work.size.iterations,
        seed=work.seed,
        tick=within(tick, 0.0, 0.8),
    )
    figures: dict[str, Any] = {
        "good_deg": wide.good_deg,
        "distorted_deg": wide.distorted_deg,
        "lost_deg": wide.lost_deg,
        "cell_deg": wide.cell_deg,
        "pitch_mm": pitch_um * 1e-3,
        "dots": [asdict(each) for each in wide.dots],
    }
    try:
        fine = dot_grid(
            replace(bench, field_points=3),
            pitch_um=PAPERS_PITCH_UM,
            distance_um=SCREEN_UM,
            reach_deg=min(_PAPERS_REACH_DEG, work.size.dot_reach_deg),
            iterations=work.size.iterations,
            seed=work.seed,
            tick=within(tick, 0.8, 0.2),
        )
        grades = [each.grade for each in fine.dots]
        figures["papers_pitch"] = {
            grade: grades.count(grade) for grade in ("good", "distorted", "lost")
        }
    except NolensError as error:
        figures["papers_pitch"] = {"refused": str(error)}
    return Found(figures, {"picture": wide.picture[None].float()})
