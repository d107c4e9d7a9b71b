"""Data sets: the same bytes by any number of processes and after kill -9, and what items cost.

`make bench-dataset` makes 1 000 items of the camera `small` by one process, by three, and by three
that are killed twice with the command, and writes the table of docs/dataset.md. Some minutes.
"""

import argparse
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil

from machine import describe, own_seconds

NOLENS = Path(sys.executable).with_name("nolens")
ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "dataset.md"
MARK = "<!-- make bench-dataset -->\n"
ERRORS = (
    "--psf-scale", "0.98,1.02", "--psf-rotation", "-1deg,1deg", "--psf-blur", "0,1",
    "--haze", "0%,10%", "--banding", "0,2", "--black-error=-8,8",
)  # fmt: skip
VARIED = ("--distance", "100mm", "--distance", "300mm", "--fill", "20%,90%", "--mirror", *ERRORS)


def make(folder: Path, *arguments: object) -> subprocess.Popen[bytes]:
    command = [NOLENS, "dataset", "make", *map(str, arguments), "-o", folder]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def timed(folder: Path, *arguments: object, clock: Callable[[], float] = time.monotonic) -> float:
    begin = clock()
    if make(folder, *arguments).wait() != 0:
        raise SystemExit(f"{folder} was not made")
    return clock() - begin


def shards(folder: Path) -> int:
    return len([*(folder / "data").glob("*-of-*")])


def killed(folder: Path, after: int, *arguments: object) -> int:
    """Kill the command when there are more shards than that; how many there are then."""
    process = make(folder, *arguments)
    workers: set[int] = set()
    while shards(folder) <= after:
        workers |= {each.pid for each in psutil.Process(process.pid).children(recursive=True)}
        time.sleep(0.01)
    time.sleep(random.uniform(0, 1))
    process.send_signal(signal.SIGKILL)
    process.wait()
    there, end = shards(folder), time.monotonic() + 30
    while any(psutil.pid_exists(each) for each in workers):
        if time.monotonic() > end:
            raise SystemExit("workers outlive the command")
        time.sleep(0.1)
    return there


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "manifest.sqlite"
    }


def same(one: Path, other: Path) -> bool:
    return contents(one) == contents(other)


def megabytes(folder: Path) -> float:
    return sum(path.stat().st_size for path in (folder / "data").iterdir()) / 1e6


def equality(folder: Path, count: int) -> list[str]:
    recipe = ("--camera", "small", "--count", count, "--shard", 50, *VARIED)
    one_s = timed(folder / "one", *recipe, "--workers", 1)
    three_s = timed(folder / "three", *recipe, "--workers", 3)
    total = shards(folder / "one")
    stops = [
        killed(folder / "killed", total * part // 4, *recipe, "--workers", 3) for part in (1, 2)
    ]
    rest_s = timed(folder / "killed", *recipe, "--workers", 2)
    kept = f"{stops[0]} and {stops[1]} of {total} shards"
    table = (*recipe[:3], 200, *recipe[4:], "--layout", "parquet")
    timed(folder / "table", *table, "--workers", 1)
    timed(folder / "tables", *table, "--workers", 3)
    rows = [
        ("one process, in one go", f"{one_s:.0f} s", "–"),
        ("three processes", f"{three_s:.0f} s", same(folder / "one", folder / "three")),
        (
            f"three, killed with {kept}, then two",
            f"{rest_s:.0f} s for the rest",
            same(folder / "one", folder / "killed"),
        ),
        ("200 items as Parquet, one and three", "–", same(folder / "table", folder / "tables")),
    ]
    return [
        f"{count} items of `small` (256×320 pixels, truth 64×80, random leaves, two distances, all "
        f"errors), {megabytes(folder / 'one'):.0f} MB; compared are the bytes of all files but "
        "`manifest.sqlite`:",
        "",
        "| made by | time | equal to the first |",
        "|---|---|---|",
        *(f"| {name} | {took} | {_yes(equal)} |" for name, took, equal in rows),
    ]


def _yes(equal: object) -> str:
    return {True: "yes", False: "**no**"}.get(equal, str(equal))  # type: ignore[call-overload]


def cost(folder: Path) -> list[str]:
    lines = [
        "| camera | truth | errors | processor s per item | MB per item |",
        "|---|---|---|---|---|",
    ]
    few = 2
    timed(folder / "first", "--camera", "small", "--workers", 1, "--count", 1)  # Fills caches.
    cameras = (("small", "64×80", 102), ("live", "222×292", 42), ("paper", "222×292", 8))
    for camera, truth, many in cameras:
        for errors in (False, True):
            recipe = ("--camera", camera, "--workers", 1, "--shard", 1, *(ERRORS if errors else ()))
            name = f"{camera}-{errors}"
            seconds = [
                timed(folder / f"{name}-{count}", *recipe, "--count", count, clock=own_seconds)
                for count in (few, many)
            ]
            each = (seconds[1] - seconds[0]) / (many - few)
            size = megabytes(folder / f"{name}-{many}") / many
            lines.append(
                f"| {camera} | {truth} | {'yes' if errors else 'no'} | {each:.2f} | {size:.2f} |"
            )
    return lines


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=1000)
    count = parser.parse_args().count
    about = describe()
    os.environ["OMP_NUM_THREADS"] = "1"
    folder = ROOT / "build" / "dataset"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    lines = [
        f"{about['cores']} cores of {about['cpu']}, {about['memory_gib']:.0f} GiB, with other work "
        "beside it (`make bench-dataset`).",
        "",
        *equality(folder, count),
        "",
        "One process, without its start and the PSFs of the camera, with random leaves, whose "
        "processor time hardly depends on other work; differences of a fifth are chance:",
        "",
        *cost(folder),
        "",
    ]
    before, _, _ = PAGE.read_text().partition(MARK)
    PAGE.write_text(before + MARK + "\n".join(lines))
    print("\n".join(lines))


if __name__ == "__main__":
    main()
