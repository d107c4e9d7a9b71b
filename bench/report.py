"""docs/benchmarks.md from the numbers of a run. Standard library only."""

from __future__ import annotations

from statistics import median
from typing import Any

from measure import MORE, NOLENS, SIDES

Json = dict[str, Any]
PEERS = SIDES[1:]
ALLOWED = 0.2  # cores kept busy by others
TARGET, TARGET_SIZE = 4.0, (1520, 2028)


def render(run: Json) -> str:
    parts = [
        intro(run),
        "## Seconds per ADMM iteration",
        timing_table(run["timing"]),
        verdict(run["timing"]),
        timing_note(run["settings"]),
        "## Peak memory",
        memory_table(run["memory"]),
        MEMORY_NOTE,
        "## Seconds until the objective that the other ends at",
        *(race_section(race) for race in run["races"]),
        *(f"Skipped: {reason}" for reason in run["skipped"]),
        *([RACE_NOTE] if run["races"] else []),
    ]
    return "\n\n".join(parts) + "\n"


def intro(run: Json) -> str:
    machine, versions = run["machine"], run["versions"]
    others = machine["others"]
    load = ", ".join(f"{value:.2f}" for value in machine["load"])
    lines = [
        "# Benchmarks",
        "",
        "Written by `make bench`; do not edit. nolens against the ADMM of the closest peer, "
        "`lensless` 1.0.8 (LenslessPiCam) from PyPI, on one machine in one go. The raw numbers "
        "are in `benchmarks.json`.",
        "",
        f"- Machine: {machine['cpu']}, {machine['cores']} cores, {machine['memory_gib']:.0f} GiB, "
        f"{machine['system']}; load average at the start {load} (1, 5, 15 minutes)"
        + ("" if others is None else f"; others kept {others:.2f} cores busy during the run"),
        f"- Date: {run['date']}; took {run['minutes']:.0f} min",
        f"- Command: `{run['command']}`",
        *(f"- {side}: {described(versions[side])}" for side in SIDES),
    ]
    if run["settings"]["quick"]:
        lines += ["", "**A quick run on small sizes, to try the benchmark out: no result.**"]
    if (machine["load"][0] if others is None else others) > ALLOWED:
        lines += ["", "**The machine was not idle: threads that wait for a core distort this.**"]
    return "\n".join(lines)


def described(versions: Json) -> str:
    names = (f"{name} {value}" for name, value in versions.items() if name != "threads")
    threads = versions["threads"]
    return ", ".join(names) + f"; {threads} thread{'s' if threads > 1 else ''}"


def timing_table(timing: list[Json]) -> str:
    rows = []
    for case in timing:
        for side in SIDES:
            found = case["sides"][side]
            each = found["s_per_iteration"]
            cells = [label(case), side, *(f"{f(each):.4f}" for f in (median, min, max))]
            cells += ["", ""] if side == NOLENS else [ratio(case, side), span(case, side)]
            rows.append([*cells, f"{found['setup_s']:.2f}"])
    head = ["size", "side", "median s", "min", "max", "ratio", "ratio min–max", "set-up s"]
    return table(head, rows)


def timing_note(settings: Json) -> str:
    return TIMING_NOTE.format(ours=settings["iterations"] * MORE[NOLENS], **settings)


def ratios(case: Json, side: str) -> list[float]:
    """The peer's time over nolens's, round by round."""
    pairs = (case["sides"][name]["s_per_iteration"] for name in (side, NOLENS))
    return [peer / ours for peer, ours in zip(*pairs, strict=True)]


def ratio(case: Json, side: str) -> str:
    return f"**{median(ratios(case, side)):.2f}×**"


def span(case: Json, side: str) -> str:
    each = ratios(case, side)
    return f"{min(each):.2f}–{max(each):.2f}"


def faster(case: Json) -> str:
    """The peer's backend with the lower median."""
    return min(PEERS, key=lambda side: median(case["sides"][side]["s_per_iteration"]))


def verdict(timing: list[Json]) -> str:
    """A plain statement against the target."""
    lines = []
    for case in timing:
        if (case["height"], case["width"]) == TARGET_SIZE:
            side = faster(case)
            reached = median(ratios(case, side))
            word = "met" if reached >= TARGET else "MISSED"
            lines.append(f"- {label(case)}: {reached:.2f}× against {side}: **{word}**")
    head = (
        f"Target: at least {TARGET:.0f}× less time per iteration than the peer's faster backend "
        "at {}×{}.".format(*TARGET_SIZE)
    )
    return "\n".join([head, "", *(lines or ["- This run has no case of that size: no statement."])])


def memory_table(memory: list[Json]) -> str:
    rows = []
    for case in memory:
        ours = case["sides"][NOLENS]["peak_mib"]
        for side in SIDES:
            found = case["sides"][side]
            peak, imports = found["peak_mib"], found["baseline_mib"]
            cells = [label(case), side, f"{peak:.0f}", f"{imports:.0f}"]
            rows.append([*cells, "" if side == NOLENS else f"{peak / ours:.2f}×"])
    return table(["size", "side", "peak MiB", "of which imports", "ratio of peaks"], rows)


def race_section(race: Json) -> str:
    sides = race["sides"]
    ends = [
        [
            side,
            str(rows[-1][0]),
            f"{rows[-1][1]:.2f}",
            f"{rows[-1][2]:.4g}",
            f"{min(r[2] for r in rows):.4g}",
        ]
        for side, rows in ((side, found["rows"]) for side, found in sides.items())
    ]
    duels = []
    for side in (name for name in sides if name != NOLENS):
        ours, theirs = sides[NOLENS]["rows"], sides[side]["rows"]
        for target, whose in ((theirs[-1][2], side), (ours[-1][2], NOLENS)):
            first, second = reached(ours, target), reached(theirs, target)
            quotient = f"**{second[1] / first[1]:.1f}×**" if first and second else "–"
            duels.append(
                [
                    f"{target:.4g} (end of {whose})",
                    said(first, ours),
                    side,
                    said(second, theirs),
                    quotient,
                ]
            )
    return "\n\n".join(
        [
            f"### {race['name']} ({race['height']}×{race['width']}, τ = {race['tau']:g})",
            table(["side", "iterations", "seconds", "ends at", "lowest seen"], ends),
            table(["objective", NOLENS, "peer", "its seconds", "ratio"], duels),
        ]
    )


def reached(rows: list[list[float]], target: float) -> list[float] | None:
    """The first row at or below the target."""
    return next((row for row in rows if row[2] <= target), None)


def said(row: list[float] | None, rows: list[list[float]]) -> str:
    if row is None:
        return f"not within {rows[-1][0]} iterations ({rows[-1][1]:.1f} s)"
    return f"{row[1]:.3f} s (iteration {row[0]})"


def label(case: Json) -> str:
    plural = "channel" if case["channels"] == 1 else "channels"
    return f"{case['height']}×{case['width']}, {case['channels']} {plural}"


def table(head: list[str], rows: list[list[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


TIMING_NOTE = """\
A synthetic caustic PSF and a sparse scene measured through it (seeded, the same files for all), \
float32. One process per side stays up; they take turns (A B C A B C) for {rounds} rounds, and a \
ratio is that of one round, the peer's time over nolens's; the table has the median of these. The \
peer is timed by two runs of its `apply` that differ by {iterations} iterations, nolens by the \
clock of its callback over {ours} iterations after the first, from a cold start, with its own \
penalties and stopping checks. Imports, compilation and one warm-up run are not counted; set-up \
(transfer functions, state) is in the last column. All run as they come: default threads, \
transforms, dtype and penalties, each on the fast domain of about twice the sensor that it picks."""

MEMORY_NOTE = """\
The most that a fresh process held (`ru_maxrss`) that loads the problem and runs it for a few \
iterations. Imports are in it: torch on every side, for the peer's numpy backend imports it too."""

RACE_NOTE = """\
Unit l2 norms, whole domain of twice the sensor; objective of the non-negative part of the iterate \
on that domain, computed for all sides by `bench/objective.py` in float64. Seconds include set-up, \
not the evaluation of the objective, imports or compilation. The peer runs with the penalties that \
it ships (1e-6, 1e-5, 4e-5); past 60 iterations its objective is looked at in steps of 3 to 6 % of \
the count."""
