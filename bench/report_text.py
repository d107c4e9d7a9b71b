"""Words and tables that every section of the report uses. Standard library only."""

from __future__ import annotations

from typing import Any

_ALLOWED = 0.2  # cores kept busy by others

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


def on_what(run: Json) -> list[str]:
    """Machine, date, command and versions of a run, as lines of a list."""
    machine, others = run["machine"], run["machine"]["others"]
    load = ", ".join(f"{value:.2f}" for value in machine["load"])
    return [
        f"- Machine: {machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']:.0f} GiB, "
        f"{machine['system']}; load average at the start {load} (1, 5, 15 minutes)"
        + ("" if others is None else f"; others kept {others:.2f} cores busy during the run"),
        f"- Date: {run['date']}; took {run['minutes']:.0f} min",
        f"- Command: `{run['command']}`",
        *(f"- {side}: {_described(each)}" for side, each in run["versions"].items()),
    ]


def busy(run: Json) -> list[str]:
    """What has to be said where others used the machine."""
    others = run["machine"]["others"]
    if (run["machine"]["load"][0] if others is None else others) <= _ALLOWED:
        return []
    return ["", "**The machine was not idle: threads that wait for a core distort this.**"]


def _described(versions: Json) -> str:
    names = (f"{name} {value}" for name, value in versions.items() if name != "threads")
    threads = versions["threads"]
    return ", ".join(names) + f"; {threads} thread{'s' if threads > 1 else ''}"
