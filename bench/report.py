"""docs/benchmarks.md from the numbers of a run. Standard library only."""

from __future__ import annotations

from statistics import median

from measure import counted
from plan import NOLENS, PAPER, SCICO
from report_parts import cuda_part, parts_sections
from report_race import race_section
from report_text import Json, busy, label, met, on_what, table

TARGET = 6.0


def render(run: Json) -> dict[str, str]:
    """Parts of the page by their marks. That of a CUDA device stays where a run has none."""
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
        *([RACE_NOTE] if run["races"] else []),
        *parts_sections(run),
        *skipped(run["skipped"]),
    ]
    cuda = cuda_part(run)
    return {"bench/run.py": "\n\n".join(parts)} | ({"bench/on_cuda.py": cuda} if cuda else {})


def intro(run: Json) -> str:
    lines = [
        "Written by `make bench`. nolens against the ADMM of the closest peer, "
        "`lensless` 1.0.8 (LenslessPiCam, two backends), and that of `scico` 0.0.7, both from "
        "PyPI, on one machine in one go; then nolens alone. The raw numbers are in "
        "`benchmarks.json`. Races at full size are in [benchmarks-race.md](benchmarks-race.md).",
        "",
        *on_what(run),
    ]
    if run["settings"]["quick"]:
        lines += ["", "**A quick run on small sizes, to try the benchmark out: no result.**"]
    return "\n".join([*lines, *busy(run)])


def timing_table(timing: list[Json]) -> str:
    rows = []
    for case in timing:
        for side, found in case["sides"].items():
            each = found["s_per_iteration"]
            cells = [label(case), side, *(f"{f(each):.4f}" for f in (median, min, max))]
            cells += ["", ""] if side == NOLENS else [ratio(case, side), span(case, side)]
            rows.append([*cells, f"{found['setup_s']:.2f}"])
    head = ["size", "side", "median s", "min", "max", "ratio", "ratio min–max", "set-up s"]
    return table(head, rows)


def timing_note(settings: Json) -> str:
    ours, scico = (counted(settings["iterations"], side) for side in (NOLENS, SCICO))
    return TIMING_NOTE.format(ours=ours, scico=scico, **settings)


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
    """The other side with the lowest median."""
    peers = [side for side in case["sides"] if side != NOLENS]
    return min(peers, key=lambda side: median(case["sides"][side]["s_per_iteration"]))


def verdict(timing: list[Json]) -> str:
    """A plain statement against the target."""
    lines = []
    for case in timing:
        if (case["height"], case["width"]) == PAPER:
            side = faster(case)
            quotient = median(ratios(case, side))
            word = met(quotient >= TARGET)
            lines.append(f"- {label(case)}: {quotient:.2f}× against {side}: {word}")
    head = (
        f"Target: at least {TARGET:.0f}× less time per iteration than the fastest other side "
        "at {}×{}.".format(*PAPER)
    )
    return "\n".join([head, "", *(lines or ["- This run has no case of that size: no statement."])])


def memory_table(memory: list[Json]) -> str:
    rows = []
    for case in memory:
        ours = case["sides"][NOLENS]["peak_mib"]
        for side, found in case["sides"].items():
            peak, imports = found["peak_mib"], found["baseline_mib"]
            cells = [label(case), side, f"{peak:.0f}", f"{imports:.0f}"]
            rows.append([*cells, "" if side == NOLENS else f"{peak / ours:.2f}×"])
    return table(["size", "side", "peak MiB", "of which imports", "ratio of peaks"], rows)


def skipped(reasons: list[str]) -> list[str]:
    return ["\n".join(["## Left out", "", *(f"- {each}" for each in reasons)])] if reasons else []


TIMING_NOTE = """\
A synthetic caustic PSF and a sparse scene measured through it (seeded, the same files for all), \
float32. One process per side stays up; they take turns (A B C D A B C D) for {rounds} rounds, \
and a ratio is that of one round, the other side's time over nolens's; the table has the median \
of these. The peer is timed by two runs of its `apply` that differ by {iterations} iterations, \
nolens by the clock of its callback over about {ours} iterations after the first few, from a cold \
start, with its own penalties and stopping checks, scico by {scico} of its `step`s, without the \
statistics that its `solve` gathers. Imports, compilation and one warm-up run are not counted; \
set-up (transfer functions, state) is in the last column, for scico with what jax compiles anew \
for each problem while it is set up. nolens and the peer run as they come: default threads, \
transforms, dtype and penalties, each on the fast domain of about twice the sensor that it picks; \
scico, which is a toolbox, on the domain that nolens picks, its crop as a diagonal operator, for \
which its proximal map has a closed form."""

MEMORY_NOTE = """\
The most that a fresh process held (`ru_maxrss`) that loads the problem and runs it for a few \
iterations. Imports are in it: torch for nolens and both backends of the peer, as its numpy \
backend imports it too; jax for scico, and what it takes to compile."""

RACE_NOTE = """\
Unit l2 norms, whole domain of twice the sensor; objective of the non-negative part of the iterate \
on that domain, computed for all sides by `bench/objective.py` in float64. Seconds include set-up, \
for scico with what jax compiles while the problem is set up, not the evaluation of iterates, \
imports or the compilation of an iteration. nolens shows its iterate every few \
iterations: what it reaches between counts at the next. The peer runs with the penalties \
that it ships (1e-6, 1e-5, 4e-5). \
scico ships none for this problem: it runs with the constants (0.1, 10, 10) that did best on the \
hand among those of `docs/decisions/0002-penalties.md`, so with a choice made for this scene, and \
without over-relaxation, its default. In the race on the binned hand, iterates past 60 iterations \
are evaluated in steps of 3 to 6 % of the count."""
