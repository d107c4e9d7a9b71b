"""`nolens measure field`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import MeasureFieldOptions, measure_field


def _lines(found: dict[str, Any]) -> list[str]:
    return _dots_lines(found) if "dots" in found else _angle_lines(found)


def _angle_lines(found: dict[str, Any]) -> list[str]:
    lines = ["half angle  correlation  at one exposure  of the overlap  overlap  light"]
    for each in found["angles"]:
        overlap, light = (
            "-" if each[name] is None else f"{100 * each[name]:.1f} %"
            for name in ("overlap_width", "light")
        )
        exposed = each["correlation_one_exposure"]
        lines.append(
            f"{each['angle_deg']:9.2f}°  {each['correlation']:11.3f}  "
            f"{'-' if exposed is None else format(exposed, '.3f'):>15}  "
            f"{each['correlation_overlap']:14.3f}  {overlap:>7}  {light:>6}"
        )
    for name, what in (
        ("correlation", "correlation of the frames"),
        ("correlation_one_exposure", "at one exposure it"),
        ("correlation_overlap", "correlation of the overlap"),
    ):
        if f"{name}_falls_to_deg" not in found:
            continue
        falls = [
            f"to {level} at {angle:.1f}°" if angle is not None else f"nowhere to {level}"
            for level, angle in found[f"{name}_falls_to_deg"].items()
        ]
        lines.append(f"{what} falls {', '.join(falls)}")
    return lines


def _dots_lines(found: dict[str, Any]) -> list[str]:
    counts = {
        name: sum(dot["grade"] == name for dot in found["dots"])
        for name in ("good", "distorted", "lost")
    }
    good, lost = found["good_deg"], found["lost_deg"]
    return [
        f"{len(found['dots'])} dots: " + ", ".join(f"{n} {name}" for name, n in counts.items()),
        f"{found['pitch_found_mm']:.3f} mm apart, turned by {found['turned_deg']:.2f}°",
        "good: " + ("nowhere" if good is None else f"up to {good:.1f}°"),
        "lost: " + ("nowhere" if lost is None else f"from {lost:.1f}° on"),
    ]


field = command(MeasureFieldOptions, measure_field, _lines, name="field")
