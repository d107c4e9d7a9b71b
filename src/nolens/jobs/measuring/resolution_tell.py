"""Figures of a resolution, in values that JSON has."""

from typing import Any

from nolens.experiments.resolution import EdgeResolution, StarResolution, TwoPoints

_HALF, _TENTH = 0.5, 0.1
_DIGITS = 5


def two_point_figures(found: TwoPoints) -> dict[str, Any]:
    """Dips by separation, and what is resolved."""
    resolved = found.resolved
    return {
        "target": "two-points",
        "resolved_deg": _short(resolved.value),
        "plus_minus_deg": _short(resolved.plus_minus),
        "largest_unresolved_deg": _short(resolved.unresolved),
        "smallest_resolved_deg": _short(resolved.resolved),
        "dip_needed": _short(found.threshold),
        "separations": [
            {
                "separation_deg": _short(angle),
                "dip": _short(dip),
                "dip_noise": _short(noise),
                "resolved": dip >= found.threshold,
            }
            for angle, dip, noise in zip(
                found.separations_deg, found.dips, found.noise, strict=True
            )
        ],
    }


def star_figures(found: StarResolution) -> dict[str, Any]:
    """Contrast by frequency and direction, and what is resolved."""
    star, worst = found.star, found.worst
    return {
        "target": "siemens",
        "resolved_deg": _short(found.resolved_everywhere_deg),
        "plus_minus_deg": _short(found.plus_minus_deg[worst]),
        "spoke_deg": _short(found.resolved_everywhere_deg / 2),
        "worst_direction_deg": _short(float(star.directions_deg[worst])),
        "finest_of_the_cells": found.at_limit[worst],
        "contrast_needed": _short(found.threshold * star.wide),
        "contrast_of_wide_spokes": _short(star.wide),
        "spokes": star.place.periods,
        "centre": [_short(each) for each in star.place.centre],
        "diameter_deg": _short(found.diameter_deg),
        "directions": [
            {
                "direction_deg": _short(float(star.directions_deg[number])),
                "resolved_deg": _short(found.resolved_deg[number]),
                "plus_minus_deg": _short(found.plus_minus_deg[number]),
                "cycles_per_deg": [_short(1 / each) for each in found.pairs_deg[number].tolist()],
                "contrast": [_short(each) for each in star.contrast[number].tolist()],
            }
            for number in range(len(found.resolved_deg))
        ],
    }


def edge_figures(found: EdgeResolution) -> dict[str, Any]:
    """Contrast by frequency across the edge."""
    response = found.response
    half, tenth = found.per_deg(_HALF), found.per_deg(_TENTH)
    return {
        "target": "edge",
        "resolved_deg": None if tenth is None else _short(1 / tenth),
        "half_contrast_per_deg": _short(half),
        "tenth_contrast_per_deg": _short(tenth),
        "tilt_deg": _short(response.tilt_deg),
        "direction_deg": _short(response.direction_deg),
        "cycles_per_deg": [_short(each / found.cell_deg) for each in response.frequencies.tolist()],
        "contrast": [_short(each) for each in response.transfer.tolist()],
    }


def _short(value: float | None) -> float | None:
    """Five digits: more is neither known nor worth the paper."""
    return None if value is None else float(f"{value:.{_DIGITS}g}")
