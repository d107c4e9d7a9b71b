"""The live view of the studio on the simulated camera: frames a second, latency, memory.

`.venv/bin/python bench/live.py --minutes 10` starts `nolens studio` as a person would, looks at its
live view as a page does, with a scene that moves like a webcam's unless `--still` is given, and
prints one JSON object; on standard error, text for the docs.
"""

import argparse
import io
import itertools
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
from PIL import Image
from websockets.sync.client import connect

from machine import describe

NOLENS = Path(sys.executable).with_name("nolens")
WARM_UP_S = 10.0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--method", choices=["admm", "wiener"], default="admm")
    parser.add_argument("--iterations", type=int)
    parser.add_argument("--still", action="store_true")
    parser.add_argument(
        "--everywhere", action="store_true",
        help="solve for all pixels of the sensor's frame, as with a camera of no known field",
    )  # fmt: skip
    given = parser.parse_args()
    machine = describe()
    with tempfile.TemporaryDirectory() as folder:
        command = [NOLENS, "studio", folder, "--no-browser", "--port", "0", "--camera", "twin"]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                url = process.stdout.readline().strip()
                found = look(process.pid, url, given)
            finally:
                process.terminate()
    found = {"machine": machine, **found}
    print(json.dumps(found))
    print(text(found), file=sys.stderr)


def look(server: int, url: str, given: argparse.Namespace) -> dict[str, Any]:
    """Look at every frame for some minutes."""
    address = url.replace("http", "ws", 1) + "api/live/frames"
    arrived: list[float] = []
    latencies: list[float] = []
    memory: list[dict[str, float]] = []
    scenes = itertools.cycle([] if given.still else moving())
    with connect(address, max_size=None) as socket:
        header: dict[str, Any] = {}
        change = {"method": given.method}
        if given.iterations is not None:
            change["iterations"] = given.iterations
        settle(socket, url, change, everywhere=given.everywhere)
        begun = time.monotonic()
        next_look = 0.0
        while (now := time.monotonic() - begun) < 60 * given.minutes:
            message = socket.recv()
            assert isinstance(message, bytes)
            socket.send("ok")
            if not given.still:
                socket.send(next(scenes))
            header = json.loads(message[4 : 4 + int.from_bytes(message[:4], "little")])
            assert any(part["name"] == "picture" for part in header["parts"]), header
            arrived.append(now)
            latencies.append(header["latency_ms"])
            if now >= next_look:
                memory.append({"s": round(now), **resident_mb(server)})
                next_look += 60 * given.minutes / 10
        memory.append({"s": round(now), **resident_mb(server)})
        columns, rows = picture_size(message, header)
    gaps = [second - first for first, second in itertools.pairwise(arrived)]
    return {
        "minutes": given.minutes,
        "moving": not given.still,
        "cells": [rows, columns],
        "method": given.method,
        "iterations": header["iterations"],
        "frames": len(arrived),
        "frames_per_s": round((len(arrived) - 1) / (arrived[-1] - arrived[0]), 2),
        "longest_gap_ms": round(1e3 * max(gaps), 1),
        "latency_ms": {
            "median": round(statistics.median(latencies), 1),
            "95 %": round(statistics.quantiles(latencies, n=20)[-1], 1),
            "most": max(latencies),
        },
        "memory_mb": memory,
    }


def picture_size(message: bytes, header: dict[str, Any]) -> tuple[int, int]:
    """Columns and rows of the picture in a message."""
    at = 4 + int.from_bytes(message[:4], "little")
    for part in header["parts"]:
        if part["name"] == "picture":
            with Image.open(io.BytesIO(message[at : at + part["bytes"]])) as picture:
                return picture.size
        at += part["bytes"]
    raise AssertionError(header)


def moving() -> list[bytes]:
    """A second and more of a webcam: spots that go round before a ground with some structure."""
    rows, columns = np.mgrid[0:240, 0:320]
    ground = 60 + 40 * np.sin(rows / 9)[..., None] * np.sin(columns / 13)[..., None]
    found = []
    for turn in np.linspace(0, 2 * np.pi, 40, endpoint=False):
        picture = np.repeat(ground, 3, axis=2)
        for colour in range(3):
            angle = turn + 2 * np.pi * colour / 3
            away = np.hypot(rows - 120 - 70 * np.sin(angle), columns - 160 - 90 * np.cos(angle))
            picture[..., colour] += 150 * (away < 35)
        buffer = io.BytesIO()
        Image.fromarray(picture.clip(0, 255).astype(np.uint8)).save(buffer, "JPEG", quality=80)
        found.append(buffer.getvalue())
    return found


def settle(socket: Any, url: str, change: dict[str, Any], *, everywhere: bool) -> None:
    """Choose what is asked for, and look until exposure and memory have settled."""
    first = socket.recv()
    assert first
    socket.send("ok")
    if everywhere:
        saved = httpx.post(url + "api/live/save", json={"as": ["raw"]}).raise_for_status().json()
        given = {"source": "twin:live", "psf": saved["psf_path"]}
        httpx.post(url + "api/live/start", json=given, timeout=60).raise_for_status()
    httpx.post(url + "api/live/settings", json=change).raise_for_status()
    end = time.monotonic() + WARM_UP_S
    while time.monotonic() < end:
        socket.recv()
        socket.send("ok")


def resident_mb(server: int) -> dict[str, float]:
    """Resident memory of the server and of its processes, by their order."""
    process = psutil.Process(server)
    found = {"server": process.memory_info().rss}
    children = sorted(process.children(), key=lambda each: each.memory_info().rss)
    # The largest has the camera; the other two are the idle process for jobs and Python's tracker.
    for name, child in zip(("live", "jobs"), reversed(children), strict=False):
        found[name] = child.memory_info().rss
    return {name: round(size / 1e6, 1) for name, size in found.items()}


def text(found: dict[str, Any]) -> str:
    """What the docs say of it."""
    memory, machine = found["memory_mb"], found["machine"]
    places = (memory[0], memory[len(memory) // 2], memory[-1])
    rows = [
        f"| {name} | " + " | ".join(f"{place[name]:.0f} MB" for place in places) + " |"
        for name in ("server", "live")
    ]
    latency, minutes = found["latency_ms"], found["minutes"]
    scene = "moving" if found["moving"] else "still"
    return "\n".join(
        [
            "Live view of the simulated camera, whose sensor has 360×480 pixels, solved for "
            f"{found['cells'][0]}×{found['cells'][1]} in colour, {found['method']} with "
            f"{found['iterations']} iterations a frame, a {scene} scene, {minutes:g} minutes on "
            f"{machine['cores']} cores of {machine['cpu']}: **{found['frames_per_s']:.1f} frames "
            f"a second**, latency {latency['median']:.0f} ms (median), {latency['95 %']:.0f} ms "
            "(95 %).",
            "",
            "| resident memory | at the start | half way | at the end |",
            "|---|---|---|---|",
            *rows,
        ]
    )


if __name__ == "__main__":
    os.environ.pop("OMP_NUM_THREADS", None)
    main()
