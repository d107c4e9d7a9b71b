"""Words and tables that every section of the report uses. Standard library only."""

from __future__ import annotations

from typing import Any

Json = dict[str, Any]


def label(case: Json) -> str:
    """Size and channels of a case."""
    plural = "channel" if case["channels"] == 1 else "channels"
    return f"{case['height']}×{case['width']}, {case['channels']} {plural}"


def met(reached: bool) -> str:
    """Whether a target was."""
    return "**met**" if reached else "**MISSED**"


def times(size: list[int]) -> str:
    """A size as rows×columns."""
    return "×".join(str(number) for number in size)


def table(head: list[str], rows: list[list[str]]) -> str:
    """Markdown of a table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)
