"""`nolens reproduce`."""

from typing import Any

from nolens.cli.command import command
from nolens.reproduction import reproduce as reproduce_job


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    for row in summary["rows"]:
        ratio = "" if row["ratio"] is None else f"  ({row['ratio']:.2f})"
        reduced = " (reduced size)" if row["reduced"] else ""
        lines.append(f"{row['what']}: {row['text']}{reduced}; the paper: {row['paper']}{ratio}")
    return [*lines, ""]


reproduce = command(reproduce_job, _lines, name="reproduce")
