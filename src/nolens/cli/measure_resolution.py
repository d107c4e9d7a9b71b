"""`nolens measure resolution`."""

from typing import Any

from cyclopts import App

from nolens.cli.command import command
from nolens.jobs import (
    EdgeOptions,
    SiemensOptions,
    TwoPointOptions,
    measure_edge,
    measure_siemens,
    measure_two_points,
)


def _pair_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"{each['separation_deg']:.3f} deg: dip {100 * each['dip']:5.1f} %"
        + (f" ± {100 * each['dip_noise']:.1f} %" if each["dip_noise"] else "")
        + ("  resolved" if each["resolved"] else "")
        for each in found["separations"]
    ]
    if found["resolved_deg"] is not None:
        lines.append(
            f"smallest resolved angle: {found['resolved_deg']:.3f} deg ± "
            f"{found['plus_minus_deg']:.3f} deg (dip of {100 * found['dip_needed']:.1f} %)"
        )
    return [*lines, *_solver_line(found)]


def _star_lines(found: dict[str, Any]) -> list[str]:
    lines = [
        f"star of {found['spokes']} bright spokes, {found['diameter_deg']:.1f} deg wide; contrast "
        f"of its widest spokes {found['contrast_of_wide_spokes']:.2f}"
    ]
    lines += [
        f"spokes at {each['direction_deg']:3.0f} deg: resolved from {each['resolved_deg']:.3f} deg "
        f"± {each['plus_minus_deg']:.3f} deg a pair"
        for each in found["directions"]
    ]
    limit = " or less" if found["finest_of_the_cells"] else ""
    lines.append(
        f"resolved in all directions: {found['resolved_deg']:.3f} deg ± "
        f"{found['plus_minus_deg']:.3f} deg a pair of lines{limit}, {found['spoke_deg']:.3f} deg a "
        f"line (contrast of {found['contrast_needed']:.3f})"
    )
    return [*lines, *_solver_line(found)]


def _edge_lines(found: dict[str, Any]) -> list[str]:
    def frequency(value: float | None) -> str:
        if value is None:
            return "nowhere up to the cells' limit"
        return f"{value:.2f} cycles/deg ({1 / value:.3f} deg a pair of lines)"

    return [
        f"edge at {found['tilt_deg']:.2f} deg; contrast along {found['direction_deg']:.1f} deg",
        f"contrast of one half at {frequency(found['half_contrast_per_deg'])}",
        f"contrast of a tenth at {frequency(found['tenth_contrast_per_deg'])}",
        *_solver_line(found),
    ]


def _solver_line(found: dict[str, Any]) -> list[str]:
    if found["iterations"] is None:
        return []
    return [f"reconstructed with {found['iterations']} iterations, tau {found['tau']:g}"]


resolution = App(
    name="resolution", help="Measure how fine a camera resolves, by one of three targets."
)
resolution.command(command(TwoPointOptions, measure_two_points, _pair_lines, name="two_points"))
resolution.command(command(SiemensOptions, measure_siemens, _star_lines, name="siemens"))
resolution.command(command(EdgeOptions, measure_edge, _edge_lines, name="edge"))
