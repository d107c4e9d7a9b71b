"""`make bench-race`: nolens against the closest peer at full size, to the peer's end.

About three quarters of an hour, nearly all of it the peer's. The hand, and a photograph with a
truth (plan.py); the results go to docs/benchmarks-race.md and .json. Run by the system's Python,
as run.py is.
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
from peer_env import LENSLESS_PEER
from plan import NOLENS, NUMPY, plan_full_size
from protocol import WorkerError
from report_race import render_race
from run import ENVIRONMENTS, ROOT, write


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="bench/race.py", description=(__doc__ or "").split("\n")[0]
    )
    parser.add_argument("--quick", action="store_true", help="small sizes, to try it out")
    parser.add_argument(
        "--data", type=Path, default=ROOT.parent / "shared" / "data", help="folder with the hand"
    )
    options = parser.parse_args()
    started = time.monotonic()
    here, others = machine.describe(), machine.Others()
    pythons = {
        NOLENS: ROOT / ".venv" / "bin" / "python", NUMPY: LENSLESS_PEER.ensure(ENVIRONMENTS),
    }  # fmt: skip
    races, skipped = plan_full_size(options.data, options.quick)
    bench = Bench(pythons, [], races, [], [], 0, 0)
    try:
        found = bench.all()
    except WorkerError as error:
        raise SystemExit(f"make bench-race: {error}") from None
    run = {
        "date": time.strftime("%Y-%m-%d"),
        "minutes": (time.monotonic() - started) / 60,
        "command": shlex.join(["python3", "bench/race.py", *sys.argv[1:]]),
        "machine": {**here, "others": others.cores()},
        "versions": found["versions"],
        "races": found["races"],
        "skipped": skipped,
    }
    folder = ROOT / "build" / "bench" if options.quick else ROOT / "docs"
    texts = {
        "benchmarks-race.md": render_race(run),
        "benchmarks-race.json": json.dumps(run, indent=1) + "\n",
    }
    write(folder, texts)


if __name__ == "__main__":
    main()
