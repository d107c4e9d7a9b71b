"""`make bench`: nolens against two peers and alone, on this machine, in one go.

Run by the system's Python with nothing but the standard library. It makes the peers' environments
(.bench-venv) when needed and measures (measure.py) what plan.py says, with one process per side;
the results go to docs/benchmarks.md and docs/benchmarks.json.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from pathlib import Path

import machine
from measure import Bench
from page import write_part
from peer_env import LENSLESS_PEER, SCICO_PEER
from plan import NOLENS, NUMPY, SCICO, TORCH, plan_cases, plan_parts, plan_races, plan_sizes
from protocol import WorkerError
from report import render
from report_text import Json

ROOT = Path(__file__).resolve().parent.parent
ENVIRONMENTS = ROOT / ".bench-venv"


def main() -> None:
    options = parse(sys.argv[1:])
    if options.again:
        measure_again(options)
        return
    started = time.monotonic()
    here = machine.describe()
    if here["load"][0] > machine.BUSY:
        print("the machine is not idle: the figures will be distorted", file=sys.stderr)
    ours = ROOT / ".venv" / "bin" / "python"
    if not ours.exists():
        raise SystemExit(f"make bench: {ours} is missing; run `make env` first")
    lensless = LENSLESS_PEER.ensure(ENVIRONMENTS)
    scico = SCICO_PEER.ensure(ENVIRONMENTS)  # after lensless, whose folder holds it
    pythons = {NOLENS: ours, NUMPY: lensless, TORCH: lensless, SCICO: scico}
    races, skipped = plan_races(options)
    sizes, too_large = plan_sizes(options.quick, here["memory_gib"])
    others = machine.Others()
    bench = Bench(
        pythons,
        plan_cases(options.quick),
        races,
        sizes,
        plan_parts(options.quick, ours.with_name("nolens")),
        options.rounds,
        options.iterations,
    )
    try:
        found = bench.all()
    except WorkerError as error:
        raise SystemExit(f"make bench: {error}") from None
    skipped += [*too_large, *found.pop("lost")]
    settings = {"rounds": options.rounds, "iterations": options.iterations, "quick": options.quick}
    run = {
        "date": time.strftime("%Y-%m-%d"),
        "minutes": (time.monotonic() - started) / 60,
        "command": shlex.join(["python3", "bench/run.py", *sys.argv[1:]]),
        "machine": {**here, "others": others.cores()},
        "settings": settings,
        **found,
        "skipped": skipped,
    }
    write(options.out, run)


def measure_again(options: argparse.Namespace) -> None:
    """Put some parts of the last run's results in place of the old ones."""
    path = options.out / "benchmarks.json"
    if not path.exists():
        raise SystemExit(f"make bench: there is no {path}: run without --again first")
    run = json.loads(path.read_text(encoding="utf-8"))
    ours = ROOT / ".venv" / "bin" / "python"
    here, others = machine.describe(), machine.Others()
    planned = plan_parts(options.quick, ours.with_name("nolens"))
    parts = [part for part in planned if part.name in options.again]
    found = Bench({NOLENS: ours}, [], [], [], parts, 0, 0).all()
    about = {"date": time.strftime("%Y-%m-%d"), "load": here["load"], "others": others.cores()}
    run["parts"].update(found["parts"])
    run["again"] = {**run.get("again", {}), **dict.fromkeys(found["parts"], about)}
    write(options.out, run)


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="bench/run.py", description=(__doc__ or "").split("\n")[0]
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="small sizes, to try it out; leaves docs/ alone")
    add("--rounds", type=int, default=5, help="rounds of taking turns (default 5)")
    add("--iterations", type=int, default=5, help="the peer's timed iterations per round (5)")
    add("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder with the hand")
    add("--ours", type=int, default=60, help="nolens's iterations on the hand (60)")
    add("--peers", type=int, default=1000, help="the peer's iterations on the binned hand (1000)")
    add(
        "--again", nargs="+", default=[], choices=["passes", "dense", "presets", "cuda"],
        help="measure only these parts, and keep the rest of the last run",
    )  # fmt: skip
    add("--out", type=Path, help="folder for the results (default docs/; build/bench/ if --quick)")
    options = parser.parse_args(arguments)
    if min(options.rounds, options.iterations, options.ours, options.peers) < 1:
        parser.error("counts must be at least 1")
    if options.out is None:
        options.out = ROOT / "build" / "bench" if options.quick else ROOT / "docs"
    return options


def write(folder: Path, run: Json) -> None:
    """Files of a run, each whole or not at all; what people wrote on the page stays."""
    folder.mkdir(parents=True, exist_ok=True)
    numbers, page = folder / "benchmarks.json", folder / "benchmarks.md"
    part = folder / f".{numbers.name}.part"
    part.write_text(json.dumps(run, indent=1) + "\n", encoding="utf-8")
    part.replace(numbers)
    for writer, text in render(run).items():
        write_part(page, writer, text)
    print(numbers, page, sep="\n")


if __name__ == "__main__":
    main()
