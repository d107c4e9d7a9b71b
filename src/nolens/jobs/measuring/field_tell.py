"""Figures of a field of view, in values that JSON has."""

from dataclasses import asdict
from typing import Any

from nolens.evaluate import falls_to
from nolens.experiments.dot_grid import DotGrid
from nolens.experiments.off_axis import OffAxis
from nolens.jobs.measuring.rounded import rounded

CORRELATIONS = (0.6, 0.3)
"""Down to the first a picture is good, below the second it is lost (`uvimprint`); the paper does
not say whether frames count by their own norms or, at one exposure, by the central one's."""


def told_angles(found: list[OffAxis]) -> dict[str, Any]:
    """Figures of PSFs from the side, in values that JSON has."""
    at = [each.angle_deg for each in found]
    told: dict[str, Any] = {"angles": [rounded(asdict(each)) for each in found]}
    for name in ("correlation", "correlation_one_exposure", "correlation_overlap"):
        values = [getattr(each, name) for each in found]
        if None not in values:
            told[f"{name}_falls_to_deg"] = {
                f"{level:g}": rounded(falls_to(level, at, values)) for level in CORRELATIONS
            }
    return told


def told_grid(grid: DotGrid) -> dict[str, Any]:
    """Figures of a grid of dots, in values that JSON has."""
    return {
        "good_deg": rounded(grid.good_deg),
        "distorted_deg": rounded(grid.distorted_deg),
        "lost_deg": rounded(grid.lost_deg),
        "pitch_found_mm": rounded(grid.pose.pitch_mm),
        "turned_deg": rounded(grid.pose.turned_deg),
        "cell_deg": rounded(grid.cell_deg),
        "dots": [rounded(asdict(dot)) for dot in grid.dots],
    }
