"""`nolens refocus`."""

from typing import Any

from nolens.cli.command import command
from nolens.files.stacks import depth_text
from nolens.jobs import refocus as refocus_job


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    if "depth_mm" in summary:
        lines.append(_depth_text(summary))
    if "stack_mm" in summary:
        depths = summary["stack_mm"]
        lines.append(f"{len(depths)} depths from {_text(depths[0])} to {_text(depths[-1])}")
    return [*lines, f"{summary['seconds']:.1f} s on {summary['device']}"]


def _depth_text(summary: dict[str, Any]) -> str:
    depth, *ends = (_text(summary[key]) for key in ("depth_mm", "sharp_from_mm", "sharp_to_mm"))
    prefix = "sharpest at " if "tried" in summary else ""
    return f"{prefix}{depth}; sharp from {' to '.join(ends)}"


def _text(millimetres: float | str) -> str:
    return millimetres if isinstance(millimetres, str) else depth_text(millimetres * 1e3)


refocus = command(refocus_job, _lines, name="refocus")
