"""Sections of the report on races: objective, and quality, against seconds. Standard library."""

from __future__ import annotations

from plan import NOLENS
from report_text import Json, busy, met, on_what, table

OBJECTIVE_TARGET, QUALITY_TARGET = 300.0, 30.0
NEAR_DB = 0.1

Row = list[float]
"""iteration, seconds, objective, PSNR (None where there is no truth)"""


def render_race(run: Json) -> str:
    """docs/benchmarks-race.md from the numbers of a run."""
    head = [
        "# Races at full size",
        "",
        "Written by `make bench-race`; do not edit. nolens against the ADMM of the closest peer, "
        "`lensless` 1.0.8 with its numpy backend, to the end of its 1000 iterations. The raw "
        "numbers are in `benchmarks-race.json`; iterations and objectives do not depend on the "
        "machine.",
        "",
        *on_what(run),
        *busy(run),
    ]
    parts = ["\n".join(head), *(race_section(race) for race in run["races"]), NOTE]
    left = ["\n".join(f"- {each}" for each in run["skipped"])] if run["skipped"] else []
    return "\n\n".join([*parts, *left]) + "\n"


def race_section(race: Json) -> str:
    """What came of one race."""
    sides = race["sides"]
    parts = [
        f"### {race['name']} ({race['height']}×{race['width']}, τ = {race['tau']:g})",
        ends(sides),
        duels(sides),
    ]
    if race["looks"] is not None:
        parts += [objective_verdict(sides), *quality(sides), looked(race)]
    return "\n\n".join(parts)


def ends(sides: Json) -> str:
    """Where every side ended."""
    rows = [
        [
            side,
            str(rows[-1][0]),
            f"{rows[-1][1]:.2f}",
            f"{rows[-1][2]:.4g}",
            f"{min(row[2] for row in rows):.4g}",
        ]
        for side, rows in ((side, found["rows"]) for side, found in sides.items())
    ]
    return table(["side", "iterations", "seconds", "ends at", "lowest seen"], rows)


def duels(sides: Json) -> str:
    """Seconds until the objective that the other ends at."""
    lines = []
    for side in others(sides):
        ours, theirs = sides[NOLENS]["rows"], sides[side]["rows"]
        for target, whose in ((theirs[-1][2], side), (ours[-1][2], NOLENS)):
            first, second = reached(ours, target), reached(theirs, target)
            quotient = f"**{second[1] / first[1]:.1f}×**" if first and second else "–"
            goal = f"{target:.4g} (end of {whose})"
            lines.append([goal, said(first, ours), side, said(second, theirs), quotient])
    return table(["objective", NOLENS, "other side", "its seconds", "ratio"], lines)


def objective_verdict(sides: Json) -> str:
    """Against the target: the objective that the other ends at, against its whole run."""
    lines = [
        f"Target: the objective that the other side ends at in {OBJECTIVE_TARGET:.0f}× less time "
        "than its run takes.",
        "",
    ]
    for side in others(sides):
        theirs = sides[side]["rows"]
        end = theirs[-1]
        ours, first = reached(sides[NOLENS]["rows"], end[2]), reached(theirs, end[2])
        assert first is not None  # the last row at the latest
        if ours is None:
            lines.append(f"- against {side}: not reached: {met(False)}")
            continue
        quotient = end[1] / ours[1]
        lines.append(
            f"- against {side}: {ours[1]:.2f} s (iteration {ours[0]}) instead of {end[1]:.1f} s "
            f"({end[0]} iterations): {quotient:.0f}×, {met(quotient >= OBJECTIVE_TARGET)}. The "
            f"other side is first that low at its iteration {first[0]}, after {first[1]:.1f} s, "
            f"{first[1] / ours[1]:.1f}× as long."
        )
    return "\n".join(lines)


def quality(sides: Json) -> list[str]:
    """Seconds until nearly the best picture that a side came by, where there is a truth."""
    if any(found["rows"][-1][3] is None for found in sides.values()):
        return []
    best = {side: max(row[3] for row in found["rows"]) for side, found in sides.items()}
    near = {
        side: next(row for row in found["rows"] if row[3] >= best[side] - NEAR_DB)
        for side, found in sides.items()
    }
    rows = [
        [
            side,
            f"{best[side]:.2f} dB",
            f"{near[side][1]:.2f} s (iteration {near[side][0]:.0f})",
            f"{found['rows'][-1][3]:.2f} dB",
        ]
        for side, found in sides.items()
    ]
    lines = [
        f"Target: within {NEAR_DB:g} dB of its own best PSNR in {QUALITY_TARGET:.0f}× less time "
        "than the other side takes to come as near to its own.",
        "",
    ]
    for side in others(sides):
        quotient = near[side][1] / near[NOLENS][1]
        level = next((row for row in sides[NOLENS]["rows"] if row[3] >= best[side]), None)
        there = f"after {level[1]:.2f} s" if level else "never"
        lines.append(
            f"- against {side}: {quotient:.1f}×: {met(quotient >= QUALITY_TARGET)} (nolens is at "
            f"the best of {side} {there})"
        )
    head = ["side", "best PSNR seen", f"within {NEAR_DB:g} dB of it", "PSNR at the end"]
    return [table(head, rows), "\n".join(lines)]


def looked(race: Json) -> str:
    """What was looked at, and how."""
    text = (
        f"Iterates are evaluated {race['looks']} times at most, in geometric steps; what lies "
        "between two evaluations counts for the later one."
    )
    if next(iter(race["sides"].values()))["rows"][-1][3] is None:
        return text
    return (
        text + " A photograph of skimage (astronaut, green, linear light) in the middle of the "
        "frame, black elsewhere, through a random mask (`bench/caustic.py`) whose PSF is known on "
        "as many pixels as the sensor has; shot noise at 90 % of the paper's full well, and read "
        "noise. No side knows where the photograph lies. PSNR after one scale factor, inside "
        "the photograph's pixels."
    )


def others(sides: Json) -> list[str]:
    return [side for side in sides if side != NOLENS]


def reached(rows: list[Row], target: float) -> Row | None:
    """The first row at or below the target."""
    return next((row for row in rows if row[2] <= target), None)


def said(row: Row | None, rows: list[Row]) -> str:
    if row is None:
        return f"not within {rows[-1][0]} iterations ({rows[-1][1]:.1f} s)"
    return f"{row[1]:.3f} s (iteration {row[0]})"


NOTE = """\
Unit l2 norms, whole domain of twice the sensor; objective of the non-negative part of the iterate \
on that domain, computed for both sides by `bench/objective.py` in float64. Seconds include \
set-up, not the evaluations, imports or compilation. nolens shows its iterate every fourth \
iteration: what it reaches between counts at the next. The peer runs with the penalties that it \
ships."""
