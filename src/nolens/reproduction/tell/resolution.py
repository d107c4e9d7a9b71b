"""Fig. 6a, b beside the paper's: two points, and a Siemens star."""

import math
from collections.abc import Mapping
from functools import partial

from nolens.jobs.measuring.resolution import draw_star, draw_two_points
from nolens.reproduction.resolution import PERIODS, POINTS_UM, STAR_DEG, read_points, read_star
from nolens.reproduction.rows import Row
from nolens.reproduction.steps import Found
from nolens.reproduction.tell.draft import Draft, Drawn, empty, refusal
from nolens.reproduction.workbench import Workbench


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
        f"non-negative solver does best, and its model is exact here: a cell of {twin.cell_um:g} "
        f"µm sees {cell_deg:.2f}°. The paper's LEDs have a size, its "
        "PSF is a captured one, and it moves LEDs in steps that it does not give.",
        sized=True,
    )
    caption = (
        "Reconstructions of two points, the light along the line through them, and the dip by "
        "separation."
    )
    drawn = Drawn("two-points", caption, partial(draw_two_points, found=points), 150.0)
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
    drawn = Drawn("siemens", caption, partial(draw_star, found=star), 165.0)
    return Draft("siemens", title, (), (drawn,), (row,))


def _cell_deg(work: Workbench) -> float:
    twin = work.preview
    return math.degrees(math.atan(twin.cell_um / twin.stack().reduced_um))
