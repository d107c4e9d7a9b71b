"""`make bench`: nolens against the closest peer, on this machine, in one go.

Run by the system's Python with nothing but the standard library. It makes the peer's environment
(.bench-venv) when needed and measures (measure.py) with one process per side; the results go to
docs/benchmarks.md and docs/benchmarks.json.
"""

from __future__ import annotations

import argparse
import json
import shlex
import sys
import time
from pathlib import Path
from typing import Any

import machine
import peer_env
from measure import NOLENS, NUMPY, TORCH, Bench, Case, Race
from protocol import WorkerError
from report import render

ROOT = Path(__file__).resolve().parent.parent
HAND = (1200, 1600)
SIZES = ((1520, 2028, 1), (1520, 2028, 3), (1200, 1600, 1))
QUICK = ((152, 202, 1), (152, 202, 3))


def main() -> None:
    options = parse(sys.argv[1:])
    started = time.monotonic()
    here = machine.describe()
    if here["load"][0] > machine.BUSY:
        print("the machine is not idle: the figures will be distorted", file=sys.stderr)
    ours = ROOT / ".venv" / "bin" / "python"
    if not ours.exists():
        raise SystemExit(f"make bench: {ours} is missing; run `make env` first")
    pythons = {NOLENS: ours, **dict.fromkeys((NUMPY, TORCH), peer_env.ensure(ROOT / ".bench-venv"))}
    races, skipped = plan_races(options)
    cases = [synthetic(*size) for size in (QUICK if options.quick else SIZES)]
    others = machine.Others()
    try:
        found = Bench(pythons, cases, races, options.rounds, options.iterations).all()
    except WorkerError as error:
        raise SystemExit(f"make bench: {error}") from None
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


def parse(arguments: list[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="bench/run.py", description=(__doc__ or "").split("\n")[0]
    )
    add = parser.add_argument
    add("--quick", action="store_true", help="small sizes, to try it out; leaves docs/ alone")
    add("--rounds", type=int, default=5, help="rounds of taking turns (default 5)")
    add("--iterations", type=int, default=5, help="the peer's timed iterations per round (5)")
    add("--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder with the hand")
    add("--full-size", action="store_true", help="solve the hand at full size too")
    add("--ours", type=int, default=60, help="nolens's iterations on the hand (60)")
    add("--peers", type=int, default=1000, help="the peer's iterations on the binned hand (1000)")
    add("--peers-full", type=int, default=300, help="the peer's iterations at full size (300)")
    add("--out", type=Path, help="folder for the results (default docs/; build/bench/ if --quick)")
    options = parser.parse_args(arguments)
    if min(options.rounds, options.iterations, options.ours, options.peers, options.peers_full) < 1:
        parser.error("counts must be at least 1")
    if options.out is None:
        options.out = ROOT / "build" / "bench" if options.quick else ROOT / "docs"
    return options


def synthetic(height: int, width: int, channels: int) -> Case:
    size = (height, width, channels)
    name = "{}×{}×{}".format(*size)
    return Case(name, *size, make=("synthetic", *(str(number) for number in size)))


def plan_races(options: argparse.Namespace) -> tuple[list[Race], list[str]]:
    """The hand, binned and at full size as asked for, or why not."""
    folder = options.data
    if (folder / "diffusercam-hand").is_dir():
        folder = folder / "diffusercam-hand"
    if not (folder / "psf_sample.tif").exists():
        return [], [
            f"the hand: there is no psf_sample.tif in {folder} (name its folder with --data)."
        ]
    peers = min(options.peers, 50) if options.quick else options.peers
    races = [hand(folder, 4, options.ours, peers)]
    if options.full_size:
        races.append(hand(folder, 1, options.ours, options.peers_full))
        return races, []
    return races, ["the hand at full size: it is done with `--full-size`."]


def hand(folder: Path, factor: int, ours: int, peers: int) -> Race:
    name = "Hand, full size" if factor == 1 else f"Hand, binned {factor}×{factor}"
    size = (HAND[0] // factor, HAND[1] // factor, 1)
    case = Case(name, *size, make=("hand", str(folder), str(factor)))
    return Race(case, {NOLENS: ours, NUMPY: peers, TORCH: peers})


def write(folder: Path, run: dict[str, Any]) -> None:
    """Both files, each whole or not at all."""
    folder.mkdir(parents=True, exist_ok=True)
    texts = {"benchmarks.md": render(run), "benchmarks.json": json.dumps(run, indent=1) + "\n"}
    for name, text in texts.items():
        part = folder / f".{name}.part"
        part.write_text(text, encoding="utf-8")
        part.replace(folder / name)
        print(folder / name)


if __name__ == "__main__":
    main()
