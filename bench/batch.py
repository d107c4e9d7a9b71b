"""Batches at scale: throughput, memory, kills, workers without a folder in common, and a model.

`.venv/bin/python bench/batch.py` makes frames of 360×480 pixels in colour, and reconstructs them
with two worker processes and with two workers of a local Dask cluster, in turns; samples memory and
processor time of all processes; does the same with other numbers of workers; kills command, worker
and scheduler at random moments and runs the command again; and measures what command and scheduler
take for a frame while workers do nothing or wait. It writes the tables of docs/scale.md. `--parts`
does some of these, and what was measured before stays in `build/batch.json`.
"""

import argparse
import contextlib
import hashlib
import json
import os
import random
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tifffile

from cases import synthetic
from machine import busy_seconds, describe
from nolens.engine import Manifest, run_items
from nolens.files import read_frame
from nolens.jobs.batch.reconstruction import PackedFrame
from nolens.jobs.batch.run import Answer

BIN = Path(sys.executable).parent
NOLENS, DASK = [sys.executable, "-m", "nolens"], str(BIN / "dask")
ENVIRONMENT = {
    **os.environ,
    "OMP_NUM_THREADS": "1",
    "PYTHONPATH": str(Path(__file__).resolve().parents[1] / "src"),
    "PYTHONWARNINGS": "ignore",
}
PAGE = Path(__file__).resolve().parents[1] / "docs" / "scale.md"
MARK = "<!-- make bench-batch -->\n"
PARTS = ("throughput", "workers", "kills", "apart", "moved")
SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
KINDS = 20
"""Different frames; more are links to these."""
KILLS = 10
SEED = 20
PICTURE_BYTES = 350_000
FRAME_BYTES = 360 * 480 * 3 * 2
PROCESSES = ("command_ms", "scheduler_ms", "workers_ms")


def make_frames(folder: Path, count: int, size: tuple[int, int]) -> tuple[Path, Path]:
    """Frames of 16 bits, and their PSF."""
    psf, measured = (np.moveaxis(each, 0, -1) for each in synthetic(*size, 3))
    frames = folder / "frames"
    frames.mkdir(parents=True)
    np.save(folder / "psf.npy", psf.astype(np.float32))
    for number in range(count):
        path = frames / f"frame-{number:05}.npy"
        if number < KINDS:
            noise = np.random.default_rng(number).normal(0, 30, measured.shape)
            counts = np.clip(measured / measured.max() * 50_000 + noise, 0, 65535)
            np.save(path, counts.astype(np.uint16))
        else:
            path.hardlink_to(frames / f"frame-{number % KINDS:05}.npy")
    return frames, folder / "psf.npy"


def command(frames: Path, psf: Path, out: Path, *more: object) -> list[str]:
    """The batch of these frames."""
    given = ("batch", "reconstruct", frames, "--psf", psf, "-o", out, "--tau", 1e-4, "--bin", 1)
    return [*NOLENS, *map(str, (*given, "--psf-flip", "none", "--black", 0, *more))]


def free_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        return int(sock.getsockname()[1])


@dataclass
class DaskCluster:
    """A scheduler and workers, each a process of its own in a folder of its own."""

    folder: Path
    workers: int
    threads: int = 1
    hidden: Path | None = None
    port: int = 0

    def __enter__(self) -> "DaskCluster":
        self.port = self.port or free_port()
        self.processes: list[subprocess.Popen[bytes]] = []
        self.scheduler = self._start(
            "scheduler", "scheduler", "--port", self.port, "--no-dashboard"
        )
        for number in range(self.workers):
            self.start_worker(number)
        return self

    @property
    def address(self) -> str:
        """Of its scheduler."""
        return f"tcp://127.0.0.1:{self.port}"

    def start_worker(self, number: int) -> subprocess.Popen[bytes]:
        """Start a worker process."""
        more = ("--nthreads", self.threads, "--memory-limit", 0, "--no-dashboard", "--no-nanny")
        return self._start(f"worker-{number}", "worker", self.address, *more)

    def _start(self, name: str, *arguments: object) -> subprocess.Popen[bytes]:
        own = self.folder / name
        own.mkdir(parents=True, exist_ok=True)
        line = [DASK, *map(str, arguments)]
        if self.hidden is not None and name != "scheduler":
            # Neither frames nor results can be seen by the worker.
            hide = f"mount -t tmpfs none {self.hidden} && exec {' '.join(line)}"
            line = ["unshare", "-m", "sh", "-c", hide]
        process = subprocess.Popen(
            line,
            cwd=own,
            env={**ENVIRONMENT, "TMPDIR": str(own)},
            **SILENT,
        )
        self.processes.append(process)
        return process

    def __exit__(self, *_: object) -> None:
        for each in self.processes:
            each.kill()
            each.wait()


class Watch:
    """Resident bytes and processor seconds of the command, its workers and a cluster, in time."""

    def __init__(self, pids: list[int]) -> None:
        self._pids, self._stop = pids, threading.Event()
        self.samples: list[dict[str, float]] = []
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._stop.wait(0.5):
            with contextlib.suppress(psutil.Error):
                main = psutil.Process(self._pids[0])
                others = [*main.children(recursive=True), *map(psutil.Process, self._pids[1:])]
                self.samples.append(
                    {
                        "at": time.monotonic(),
                        "command_mb": main.memory_info().rss / 1e6,
                        "others_mb": sum(each.memory_info().rss for each in others) / 1e6,
                        "command_s": _used(main),
                        "others_s": sum(map(_used, others)),
                        "busy_s": busy_seconds() or 0.0,
                    }
                )

    def end(self) -> list[dict[str, float]]:
        """All samples."""
        self._stop.set()
        self._thread.join()
        return self.samples


def _used(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def timed(line: list[str], pids: list[int], frames: int) -> dict[str, Any]:
    """Run a batch to its end; rate, processor time and memory of its middle."""
    out = Path(line[line.index("-o") + 1])
    process = subprocess.Popen(
        line, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    )
    watch = Watch([process.pid, *pids])
    done: list[tuple[float, int]] = []
    while process.poll() is None:
        done.append((time.monotonic(), len(there(out))))
        time.sleep(0.5)
    assert process.stderr is not None
    if process.returncode != 0:
        raise SystemExit(process.stderr.read().decode())
    samples = watch.end()
    # From a tenth of the frames to nine tenths, in four parts: neither the start nor the end.
    marks = [next(each for each in done if each[1] >= frames * at / 10) for at in (1, 3, 5, 7, 9)]
    (begun, first), (ended, last) = marks[0], marks[-1]
    middle = [each for each in samples if begun <= each["at"] <= ended]
    count = last - first
    used = {name: middle[-1][name] - middle[0][name] for name in middle[0]}
    others = used["busy_s"] - used["command_s"] - used["others_s"]
    at = [middle[int(part * (len(middle) - 1))] for part in (0, 1 / 3, 2 / 3, 1)]
    return {
        "frames": frames,
        "rate": count / (ended - begun),
        "rates": [
            (later[1] - before[1]) / max(0.5, later[0] - before[0])
            for before, later in pairwise(marks)
        ],
        "command_ms": 1e3 * used["command_s"] / count,
        "others_ms": 1e3 * used["others_s"] / count,
        "other_work_cores": max(0.0, others / used["at"]),
        "memory_mb": [(round(each["command_mb"]), round(each["others_mb"])) for each in at],
    }


def measured(
    folder: Path, frames: Path, psf: Path, kind: str, workers: int, *more: object
) -> dict[str, Any]:
    """A batch by so many processes or Dask workers."""
    out = folder / "out"
    with ExitStack() as stack:
        pids = []
        where: tuple[object, ...] = ("--workers", workers)
        if kind == "dask":
            cluster = stack.enter_context(DaskCluster(folder / "dask", workers))
            pids = [each.pid for each in cluster.processes]
            where = ("--scheduler", cluster.address)
            time.sleep(8)  # All workers are there.
        line = command(frames, psf, out, *where, *more)
        row = {"kind": kind, "workers": workers, **timed(line, pids, len(list(frames.iterdir())))}
    print(json.dumps(row), flush=True)
    shutil.rmtree(out)
    return row


def throughput(folder: Path, count: int, rounds: int) -> list[dict[str, Any]]:
    """Two processes and two Dask workers in turns, at the quality that takes least time.

    After the first round those of an eighth of the frames: other work on the machine changes.
    """
    rows = []
    for number in range(rounds):
        some = count if number == 0 else count // 8
        frames, psf = make_frames(folder / str(number), some, (360, 480))
        for kind in ("processes", "dask") if number % 2 == 0 else ("dask", "processes"):
            rows.append(measured(folder, frames, psf, kind, 2, "--quality", "draft"))
    return rows


def workers(folder: Path) -> list[dict[str, Any]]:
    """Other numbers of workers, and the default quality."""
    rows = []
    for quality, count, numbers in (("draft", 240, (1, 3)), ("photo", 24, (2,))):
        frames, psf = make_frames(folder / quality, count, (360, 480))
        for number in numbers:
            for kind in ("processes", "dask"):
                row = measured(folder, frames, psf, kind, number, "--quality", quality)
                rows.append({"quality": quality, **row})
    return rows


def there(out: Path) -> list[Path]:
    """Pictures that are written, without those that are being written."""
    return list(out.glob("[!.]*.png"))


def pictures(out: Path) -> dict[str, str]:
    return {each.name: hashlib.sha256(each.read_bytes()).hexdigest() for each in there(out)}


def spawned_by(process: "subprocess.Popen[bytes]") -> list[int]:
    """Worker processes of a command."""
    try:
        children = psutil.Process(process.pid).children()
        return [each.pid for each in children if "spawn_main" in " ".join(each.cmdline())]
    except psutil.Error:
        return []


def kills(folder: Path, count: int) -> list[dict[str, Any]]:
    """Kill one of three when so many pictures are there, at random; run again until all are."""
    frames, psf = make_frames(folder / "small", count, (120, 160))
    quick = ("--quality", "draft")
    good = folder / "good"
    subprocess.run(command(frames, psf, good, *quick, "--workers", 1), env=ENVIRONMENT, check=True)
    expected, rows = pictures(good), []
    assert len(expected) == count
    chance = random.Random(SEED)
    for what in ("worker", "scheduler", "command"):
        exits, partly, made = [], [], 0
        for number in range(KILLS):
            out = folder / f"{what}-{number}"
            with ExitStack() as stack:
                cluster: DaskCluster | None = None
                more: tuple[object, ...] = ("--workers", 2)
                if what == "scheduler" or (what == "worker" and number % 2):
                    cluster = stack.enter_context(DaskCluster(folder / f"c-{what}-{number}", 2))
                    more = ("--scheduler", cluster.address)
                    time.sleep(4)
                line = command(frames, psf, out, *quick, *more)
                process = subprocess.Popen(line, env=ENVIRONMENT, **SILENT)
                wanted = chance.randrange(count)
                while process.poll() is None and len(there(out)) < wanted:
                    time.sleep(0.01)
                time.sleep(chance.uniform(0, 0.1))
                partly.append(len(there(out)))
                victim = process.pid
                if what == "scheduler" and cluster is not None:
                    victim = cluster.scheduler.pid
                elif what == "worker" and cluster is not None:
                    victim = chance.choice(cluster.processes[1:]).pid
                elif what == "worker":
                    spawned = spawned_by(process)
                    victim = chance.choice(spawned) if spawned else 0
                if victim:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(victim, signal.SIGKILL)
                try:
                    exits.append(process.wait(120))
                except subprocess.TimeoutExpired:
                    process.kill()
                    exits.append("hung")
            before = {path: path.stat().st_mtime_ns for path in there(out)}
            again = command(frames, psf, out, *quick, "--workers", 1)
            subprocess.run(again, env=ENVIRONMENT, check=True, **SILENT)
            rewritten = sum(path.stat().st_mtime_ns != at for path, at in before.items())
            made += pictures(out) == expected and rewritten == 0
            shutil.rmtree(out)
            print(what, number, exits[-1], partly[-1], made, flush=True)
        rows.append({"what": what, "kills": KILLS, "good": made, "exits": exits, "there": partly})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def apart(folder: Path, count: int) -> dict[str, Any]:
    """Three workers that see neither frames nor results, against one process."""
    inputs = folder / "apart"
    frames, psf = make_frames(inputs, count, (120, 160))
    linear = ("--iterations", 24, "--formats", "tif", "--tiff-bits", 32)
    outs = {name: inputs / name for name in ("one", "three")}
    alone = command(frames, psf, outs["one"], *linear, "--workers", 1)
    subprocess.run(alone, env=ENVIRONMENT, check=True)
    with DaskCluster(folder / "three", 3, hidden=inputs) as cluster:
        time.sleep(10)
        line = command(frames, psf, outs["three"], *linear, "--scheduler", cluster.address)
        subprocess.run(line, env=ENVIRONMENT, check=True)
    worst = 0.0
    for path in sorted(outs["one"].glob("*.tif")):
        one, three = (tifffile.imread(outs[name] / path.name) for name in outs)
        worst = max(worst, float(np.abs(one - three).max() / np.abs(one).max()))
    row = {"frames": count, "largest_relative_difference": worst}
    print(json.dumps(row), flush=True)
    return row


@dataclass(frozen=True)
class Waiting:
    """Work without computing, with frames and pictures of the usual size."""

    picture: bytes
    seconds: float

    def prepare(self) -> Callable[[PackedFrame], Answer]:
        """What answers after that time."""
        return self._answer

    def _answer(self, packed: PackedFrame) -> Answer:
        time.sleep(self.seconds)
        return Answer({"png": self.picture}, {"seconds": self.seconds})


MOVED: tuple[tuple[str, int, int, float, int], ...] = (
    ("processes", 2, 1, 0.0, 200),
    ("dask", 2, 1, 0.0, 400),
    ("dask", 2, 20, 8.0, 160),
    ("dask", 2, 20, 4.0, 200),
    ("dask", 2, 20, 2.0, 280),
)
"""Kind, processes, threads in each, seconds that a frame waits there, frames."""


def moved(folder: Path) -> list[dict[str, Any]]:
    """What command, scheduler and workers take for a frame while workers compute nothing."""
    frames, _ = make_frames(folder / "moved", KINDS, (360, 480))
    paths = sorted(frames.iterdir())
    picture = np.random.default_rng(SEED).bytes(PICTURE_BYTES)
    rows = []
    for number, (kind, processes, threads, wait_s, count) in enumerate(MOVED):
        out = folder / f"moved-{number}"
        keys = [f"f{number}" for number in range(count)]
        items = [(key, partial(_packed, paths[at % KINDS])) for at, key in enumerate(keys)]
        with ExitStack() as stack:
            scheduler, pids = None, list[int]()
            if kind == "dask":
                cluster = DaskCluster(folder / f"moved-dask-{number}", processes, threads)
                stack.enter_context(cluster)
                scheduler = cluster.address
                pids = [each.pid for each in cluster.processes]
                time.sleep(5 + processes)
            manifest = Manifest.open(out, {}, keys)
            work = Waiting(picture, wait_s)
            skipped = processes * threads  # All workers have begun.
            marks: list[tuple[float, list[float]]] = []
            for done, outcome in enumerate(
                run_items(items, work, workers=processes, scheduler=scheduler)
            ):
                files = {out / f"{outcome.key}.png": partial(_write, outcome.value.files["png"])}
                manifest.keep(outcome.key, outcome.value.row, files)
                if done in (skipped, count - skipped):
                    workers_s = sum(_used(psutil.Process(pid)) for pid in pids[1:])
                    scheduler_s = _used(psutil.Process(pids[0])) if pids else 0.0
                    marks.append((time.monotonic(), [time.process_time(), scheduler_s, workers_s]))
            manifest.close()
        (begun, first), (ended, last) = marks
        each = 1e3 / (count - 2 * skipped)
        spent = [each * (after - before) for before, after in zip(first, last, strict=True)]
        row = {"kind": kind, "workers": processes * threads, "wait_s": wait_s, "frames": count}
        row["rate"] = 1e3 / each / (ended - begun)
        rows.append({**row, **dict(zip(PROCESSES, spent, strict=True))})
        print(json.dumps(rows[-1]), flush=True)
    return rows


def _packed(path: Path) -> PackedFrame:
    return PackedFrame.of(read_frame(path))


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def model(rows: list[dict[str, Any]]) -> list[str]:
    """Cost of a frame by a line through two measurements, checked with a third; 100 workers.

    A process is busy for b + r·c seconds in each, at r frames a second. W workers that take s
    for a frame want W/s; no process can be busy for more than a second in each.
    """
    few, more, check = rows[-3:]
    slope, base = {}, {}
    lines = [
        "| process | b, of a core | c, ms | measured at the third rate, of a core | by the model |",
        "|---|---|---|---|---|",
    ]
    for name in PROCESSES:
        busy = [row[name] * row["rate"] / 1e3 for row in (few, more, check)]
        slope[name] = (busy[1] - busy[0]) / (more["rate"] - few["rate"])
        base[name] = busy[0] - slope[name] * few["rate"]
        lines.append(
            f"| {name.removesuffix('_ms')} | {base[name]:.2f} | {1e3 * slope[name]:.1f} | "
            f"{busy[2]:.2f} | {base[name] + slope[name] * check['rate']:.2f} |"
        )
    limit = min((1 - base[name]) / slope[name] for name in PROCESSES[:2])
    lines += [
        "",
        f"Most frames a second for one command, one frame a task: {limit:.0f}.",
        "",
        "| workers | s a frame | frames/s | tasks/s | command, of a core | scheduler, of a core | "
        "read, MB/s | written, MB/s | through the scheduler, MB/s in and out | workers busy |",
        "|" + "---|" * 10,
    ]
    for count, seconds in ((10, 0.5), (10, 2.0), (100, 0.5), (100, 1.0), (100, 2.0), (100, 10.0)):
        rate = min(count / seconds, limit)
        busy = [base[name] + slope[name] * rate for name in PROCESSES[:2]]
        lines.append(
            f"| {count} | {seconds:g} | {rate:.0f} | {rate:.0f} | {busy[0]:.2f} | {busy[1]:.2f} | "
            f"{rate * FRAME_BYTES / 1e6:.0f} | {rate * PICTURE_BYTES / 1e6:.0f} | "
            f"{rate * (FRAME_BYTES + PICTURE_BYTES) / 1e6:.0f} | "
            f"{100 * rate * seconds / count:.0f} % |"
        )
    return lines


def runs(rows: list[dict[str, Any]]) -> list[str]:
    """Rate, processor time and memory of batches."""
    lines = [
        "| workers | quality | frames | frames/s, in four parts | command, ms | workers and "
        "scheduler, ms | other work, cores | command, MB | others, MB |",
        "|" + "---|" * 9,
    ]
    for row in rows:
        mine, rest = (" ".join(map(str, each)) for each in zip(*row["memory_mb"], strict=True))
        rates = " ".join(f"{each:.1f}" for each in row["rates"])
        lines.append(
            f"| {row['workers']} {row['kind']} | {row.get('quality', 'draft')} | {row['frames']} | "
            f"{row['rate']:.1f} ({rates}) | {row['command_ms']:.1f} | {row['others_ms']:.0f} | "
            f"{row['other_work_cores']:.1f} | {mine} | {rest} |"
        )
    return lines


def tables(found: dict[str, Any]) -> str:
    """What docs/scale.md has."""
    rows = found["throughput"]
    rates, costs = (
        {kind: [of(row) for row in rows if row["kind"] == kind] for kind in ("dask", "processes")}
        for of in (lambda row: row["rate"], lambda row: row["command_ms"] + row["others_ms"])
    )
    rate, cost = (
        sum(each["dask"]) / len(each["dask"]) / (sum(each["processes"]) / len(each["processes"]))
        for each in (rates, costs)
    )
    about = found["machine"]
    lines = [
        f"{about['cores']} cores of {about['cpu']}, {about['memory_gib']:.0f} GiB.",
        "",
        *runs([*rows, *found.get("workers", [])]),
        "",
        f"Dask's rate is {rate:.2f} of that of processes, its processor time {cost:.2f} of theirs.",
        "",
        "| killed | times | all there, once, equal | exit codes | pictures there when it was |",
        "|---|---|---|---|---|",
    ]
    for row in found["kills"]:
        codes = ", ".join(f"{row['exits'].count(code)} × {code}" for code in {*row["exits"]})
        there = " ".join(map(str, row["there"]))
        lines.append(f"| {row['what']} | {row['kills']} | {row['good']} | {codes} | {there} |")
    apart = found["apart"]
    lines += [
        "",
        f"Largest relative difference of {apart['frames']} pictures by three workers in folders of "
        f"their own: {apart['largest_relative_difference']:.1g}.",
        "",
        "| workers | a frame waits, s | frames | frames/s | command, ms | scheduler, ms | "
        "workers, ms |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found["moved"]:
        lines.append(
            f"| {row['workers']} {row['kind']} | {row['wait_s']:g} | {row['frames']} | "
            f"{row['rate']:.1f} | {row['command_ms']:.1f} | {row['scheduler_ms']:.1f} | "
            f"{row['workers_ms']:.1f} |"
        )
    return "\n".join([*lines, "", *model(found["moved"])]) + "\n"


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="nolens-batch-") as name:
        yield Path(name)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=6)
    parser.add_argument("--parts", nargs="+", default=PARTS)
    parser.add_argument("--out", type=Path, default=Path("build/batch.json"))
    options = parser.parse_args()
    options.out.parent.mkdir(exist_ok=True)
    found = json.loads(options.out.read_text()) if options.out.exists() else {}
    found["machine"] = describe()
    parts: dict[str, Callable[[Path], Any]] = {
        "throughput": lambda at: throughput(at, options.frames, options.rounds),
        "kills": lambda at: kills(at, 24),
        "apart": lambda at: apart(at, 30),
        "moved": moved,
        "workers": workers,
    }
    for name in options.parts:
        with _folder() as folder:
            found[name] = parts[name](folder)
        options.out.write_text(json.dumps(found, indent=1))
    if {*parts} - {"workers"} <= {*found}:
        before, _, _ = PAGE.read_text().partition(MARK)
        PAGE.write_text(before + MARK + "\n" + tables(found))


if __name__ == "__main__":
    main()
