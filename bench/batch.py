"""Batches at scale: throughput, memory, kills, workers without a folder in common, and a model.

`.venv/bin/python bench/batch.py` makes frames of 360×480 pixels in colour, and reconstructs them
with two worker processes and with two workers of a local Dask cluster, in turns; samples the memory
of all processes; kills command, worker and scheduler at random moments and runs the command again;
and measures what the command and the scheduler can move when workers do nothing. It prints the
tables of docs/scale.md. `--parts` does some of these.
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
from pathlib import Path
from typing import Any

import numpy as np
import psutil
import tifffile

from cases import synthetic
from machine import Others, describe
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
SILENT: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
KINDS = 20
"""Different frames; more are links to these."""
KILLS = 10
SEED = 20


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
        """Start a worker of one thread."""
        more = ("--nthreads", 1, "--memory-limit", 0, "--no-dashboard", "--no-nanny")
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
    others = Others()
    process = subprocess.Popen(line, env=ENVIRONMENT, stderr=subprocess.PIPE)
    watch = Watch([process.pid, *pids])
    done: list[tuple[float, int]] = []
    while process.poll() is None:
        done.append((time.monotonic(), sum(1 for _ in out.glob("*.png"))))
        time.sleep(0.5)
    assert process.stderr is not None
    if process.returncode != 0:
        raise SystemExit(process.stderr.read().decode())
    samples = watch.end()
    # From a tenth of the frames to nine tenths: neither the start nor the end.
    begun, first = next(each for each in done if each[1] >= frames // 10)
    ended, last = next(each for each in done if each[1] >= frames * 9 // 10)
    middle = [each for each in samples if begun <= each["at"] <= ended]
    count = last - first
    used = {
        name: 1e3 * (middle[-1][name] - middle[0][name]) / count
        for name in ("command_s", "others_s")
    }
    marks = [middle[int(part * (len(middle) - 1))] for part in (0, 1 / 3, 2 / 3, 1)]
    return {
        "rate": count / (ended - begun),
        "command_ms": used["command_s"],
        "others_ms": used["others_s"],
        "other_work_cores": others.cores(),
        "memory_mb": [(round(each["command_mb"]), round(each["others_mb"])) for each in marks],
    }


def throughput(folder: Path, count: int, rounds: int) -> list[dict[str, Any]]:
    """Two processes and two Dask workers in turns."""
    frames, psf = make_frames(folder / "large", count, (360, 480))
    rows = []
    for number in range(rounds):
        for kind in ("processes", "dask") if number % 2 == 0 else ("dask", "processes"):
            out = folder / f"out-{kind}-{number}"
            with ExitStack() as stack:
                more: tuple[object, ...] = ("--workers", 2)
                pids = []
                if kind == "dask":
                    cluster = stack.enter_context(DaskCluster(folder / f"dask-{number}", 2))
                    more = ("--scheduler", cluster.address)
                    pids = [each.pid for each in cluster.processes]
                    time.sleep(8)  # Both workers are there.
                line = command(frames, psf, out, "--quality", "draft", *more)
                rows.append({"kind": kind, **timed(line, pids, count)})
            print(json.dumps(rows[-1]), flush=True)
            shutil.rmtree(out)
    return rows


def pictures(out: Path) -> dict[str, str]:
    return {each.name: hashlib.sha256(each.read_bytes()).hexdigest() for each in out.glob("*.png")}


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
    quick = ("--iterations", 12)
    good = folder / "good"
    subprocess.run(command(frames, psf, good, *quick, "--workers", 1), env=ENVIRONMENT, check=True)
    expected, rows = pictures(good), []
    assert len(expected) == count
    chance = random.Random(SEED)
    for what in ("command", "worker", "scheduler"):
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
                while process.poll() is None and sum(1 for _ in out.glob("*.png")) < wanted:
                    time.sleep(0.01)
                time.sleep(chance.uniform(0, 0.1))
                partly.append(len(list(out.glob("*.png"))))
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
            before = {path: path.stat().st_mtime_ns for path in out.glob("*.png")}
            again = command(frames, psf, out, *quick, "--workers", 2)
            subprocess.run(again, env=ENVIRONMENT, check=True, **SILENT)
            rewritten = sum(path.stat().st_mtime_ns != at for path, at in before.items())
            made += pictures(out) == expected and rewritten == 0
            shutil.rmtree(out)
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
class Nothing:
    """Work of no time with frames and pictures of the usual size."""

    picture: bytes

    def prepare(self) -> Callable[[PackedFrame], Answer]:
        """What answers."""
        return self._answer

    def _answer(self, packed: PackedFrame) -> Answer:
        return Answer({"png": self.picture}, {"seconds": 0.0})


def moved(folder: Path, count: int) -> list[dict[str, Any]]:
    """Frames a second that command and scheduler move when workers do nothing."""
    frames, _ = make_frames(folder / "moved", KINDS, (360, 480))
    paths = sorted(frames.iterdir())
    picture = np.random.default_rng(SEED).bytes(350_000)
    rows = []
    for kind in ("processes", "dask"):
        out = folder / f"moved-{kind}"
        keys = [f"f{number}" for number in range(count)]
        items = [(key, partial(_packed, paths[at % KINDS])) for at, key in enumerate(keys)]
        with ExitStack() as stack:
            scheduler = None
            if kind == "dask":
                cluster = stack.enter_context(DaskCluster(folder / "moved-dask", 2))
                scheduler = cluster.address
                time.sleep(8)
            manifest = Manifest.open(out, {}, keys)
            begun, used, scheduling = 0.0, 0.0, 0.0
            for outcome in run_items(items, Nothing(picture), workers=2, scheduler=scheduler):
                if not begun:
                    begun, used = time.monotonic(), time.process_time()
                    scheduling = _scheduler_s(cluster) if scheduler else 0.0
                files = {out / f"{outcome.key}.png": partial(_write, outcome.value.files["png"])}
                manifest.keep(outcome.key, outcome.value.row, files)
            seconds = time.monotonic() - begun
            used = time.process_time() - used
            scheduling = _scheduler_s(cluster) - scheduling if scheduler else 0.0
            manifest.close()
        each = 1e3 / (count - 1)
        rows.append(
            {
                "kind": kind,
                "rate": (count - 1) / seconds,
                "command_ms": each * used,
                "scheduler_ms": each * scheduling,
            }
        )
        print(json.dumps(rows[-1]), flush=True)
    return rows


def _scheduler_s(cluster: DaskCluster) -> float:
    return _used(psutil.Process(cluster.scheduler.pid))


def _packed(path: Path) -> PackedFrame:
    return PackedFrame.of(read_frame(path))


def _write(content: bytes, path: Path) -> None:
    path.write_bytes(content)


def tables(found: dict[str, Any]) -> str:
    """The tables of docs/scale.md."""
    lines = [
        "| workers | frames/s | command, ms | workers and scheduler, ms | other work, cores | "
        "command, MB | others, MB |",
        "|---|---|---|---|---|---|---|",
    ]
    rows = found["throughput"]
    for row in rows:
        mine, rest = (" ".join(map(str, each)) for each in zip(*row["memory_mb"], strict=True))
        lines.append(
            f"| {row['kind']} | {row['rate']:.1f} | {row['command_ms']:.1f} | "
            f"{row['others_ms']:.0f} | {row['other_work_cores']:.1f} | {mine} | {rest} |"
        )
    for name, columns in (("rate", ("rate",)), ("cost", ("command_ms", "others_ms"))):
        mean = {
            kind: sum(sum(row[c] for c in columns) for row in rows if row["kind"] == kind)
            for kind in ("dask", "processes")
        }
        lines.append(f"dask/processes, {name}: {mean['dask'] / mean['processes']:.3f}")
    lines += [
        "",
        "| killed | times | good | exit codes | pictures there |",
        "|---|---|---|---|---|",
    ]
    for row in found["kills"]:
        codes = ", ".join(f"{row['exits'].count(code)}× {code}" for code in {*row["exits"]})
        there = " ".join(map(str, row["there"]))
        lines.append(f"| {row['what']} | {row['kills']} | {row['good']} | {codes} | {there} |")
    lines += ["", "| way | frames/s | command, ms | scheduler, ms |", "|---|---|---|---|"]
    for row in found["moved"]:
        lines.append(
            f"| {row['kind']} | {row['rate']:.0f} | {row['command_ms']:.1f} | "
            f"{row['scheduler_ms']:.1f} |"
        )
    return "\n".join([*lines, "", json.dumps(found["apart"])]) + "\n"


@contextmanager
def _folder() -> Iterator[Path]:
    with tempfile.TemporaryDirectory(prefix="nolens-batch-") as name:
        yield Path(name)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--frames", type=int, default=2000)
    parser.add_argument("--rounds", type=int, default=2)
    parser.add_argument("--parts", nargs="+", default=["throughput", "kills", "apart", "moved"])
    parser.add_argument("--out", type=Path, default=Path("build/batch.json"))
    options = parser.parse_args()
    options.out.parent.mkdir(exist_ok=True)
    found = json.loads(options.out.read_text()) if options.out.exists() else {}
    found["machine"] = describe()
    parts: dict[str, Callable[[Path], Any]] = {
        "throughput": lambda at: throughput(at, options.frames, options.rounds),
        "kills": lambda at: kills(at, 24),
        "apart": lambda at: apart(at, 30),
        "moved": lambda at: moved(at, 600),
    }
    for name in options.parts:
        with _folder() as folder:
            found[name] = parts[name](folder)
        options.out.write_text(json.dumps(found, indent=1))
    if {*parts} <= {*found}:
        print(tables(found))


if __name__ == "__main__":
    main()
