"""What the installed command takes for a photograph, for each quality, its start included.

`presets.py NOLENS HEIGHT WIDTH CHANNELS SIDE` prints one JSON object. Standard library only: the
peak memory that Linux gives for a child is at least what its parent held when it started it.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
RUNS = 3
DRAFT, PHOTO, EVERYWHERE = "draft", "photo, with its support", "photo, light from everywhere"


def measured(command: list[str], folder: Path) -> dict[str, Any]:
    """Seconds and peak memory of one run, and what the command itself says."""
    with (folder / "stdout").open("w+") as out, (folder / "stderr").open("w+") as err:
        start = time.monotonic()
        process = subprocess.Popen(command, stdout=out, stderr=err)
        _, status, used = os.wait4(process.pid, 0)
        seconds = time.monotonic() - start
        process.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if process.returncode:
            sys.exit(f"nolens ended with {process.returncode}: {err.read().strip()}")
        summary: dict[str, Any] = json.loads(out.read())
    unit = 1 if sys.platform == "darwin" else 1024
    return {
        "seconds": seconds,
        "peak_gb": used.ru_maxrss * unit / 1e9,
        "own_seconds": summary["seconds"],
        "iterations": summary["iterations"],
        "stop_reason": summary["stop_reason"],
    }


def main(nolens: str, *size: str) -> None:
    with tempfile.TemporaryDirectory(prefix="nolens-presets-") as name:
        folder = Path(name)
        python = Path(nolens).with_name("python")
        make = [python, HERE / "cases.py", "photograph", folder, *size]
        subprocess.run([str(word) for word in make], check=True)
        inputs = [str(folder / "data.npy"), "--psf", str(folder / "psf.npy")]
        command = [nolens, "reconstruct", *inputs, "-o", str(folder / "out.png"), "--json"]
        confined = ("--support", f"{size[-1]}x{size[-1]}")
        ways = {
            DRAFT: ("--quality", "draft"),
            PHOTO: ("--quality", "photo", *confined),
            EVERYWHERE: ("--quality", "photo"),
        }
        runs = {
            name: [measured([*command, *way], folder) for _ in range(RUNS)]
            for name, way in ways.items()
        }
    print(json.dumps({"size": [int(number) for number in size], "runs": runs}))


if __name__ == "__main__":
    main(*sys.argv[1:])
