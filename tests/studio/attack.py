"""Attacks on a studio of its own, while the time in which it answers is measured.

`.venv/bin/python tests/studio/attack.py` starts `nolens studio` over a workspace of damaged files
and of links that lead out of it, looks at it with 16 pages, one of which stops reading, and attacks
it. Every attack must end as it should, standard error stay without a traceback, and
`GET /api/about` answer in time throughout. The exit code says whether all held.
"""

import argparse
import json
import os
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import psutil
from PIL import Image
from serving import NOLENS, Running
from websockets.exceptions import ConnectionClosed, ConnectionClosedError
from websockets.sync.client import connect

from patience import PATIENCE_S

PAGES = 16
PAUSE_S = 0.05
JOBS, WAITING = 200, 50
SECRET = "the-secret-of-this-attack"
LONG = {
    "measurement": "work/long.npy", "psf": "work/long-psf.npy", "iterations": 10**6, "tolerance": 0,
}  # fmt: skip
SHORT = {"measurement": "work/raw.npy", "psf": "work/psf.npy", "iterations": 4}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--most-ms", type=float, default=100.0, help="slowest answer allowed")
    parser.add_argument("--probe", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.probe is not None:
        probe(given.probe)
        return 0
    with tempfile.TemporaryDirectory() as folder:
        return report(attacked(Path(folder)), given.most_ms)


@dataclass
class Attacked:
    """What came of it."""

    wrong: list[str] = field(default_factory=list)
    said: list[str] = field(default_factory=list)
    milliseconds: list[tuple[str, float]] = field(default_factory=list)
    late: list[float] = field(default_factory=list)

    def check(self, what: str, *, holds: bool, shown: object = "") -> None:
        self.said.append(f"{'ok  ' if holds else 'FAIL'} {what}" + (f": {shown}" if shown else ""))
        print(self.said[-1], flush=True)
        if not holds:
            self.wrong.append(what)


def report(found: Attacked, most_ms: float) -> int:
    times = sorted(each for _, each in found.milliseconds)
    by_attack: dict[str, float] = {}
    for name, each in found.milliseconds:
        by_attack[name] = max(each, by_attack.get(name, 0.0))
    for name, slowest in by_attack.items():
        print(f"     GET /api/about, {name}: slowest {slowest:.0f} ms")
    late = sorted(found.late)
    print(
        f"     who sleeps on this machine is woken {statistics.median(late):.1f} ms late "
        f"(median), {late[-1]:.1f} ms (most)"
    )
    found.check(
        f"GET /api/about answers in {most_ms:g} ms throughout",
        holds=times[-1] < most_ms,
        shown=f"{len(times)} requests, median {statistics.median(times):.1f} ms, "
        f"99 % {times[int(0.99 * len(times))]:.1f} ms, slowest {times[-1]:.1f} ms",
    )
    print(f"{len(found.said) - len(found.wrong)} of {len(found.said)} held")
    return 1 if found.wrong else 0


def attacked(folder: Path) -> Attacked:
    work, found = folder / "work", Attacked()
    prepare(work, folder)
    command = [NOLENS, "studio", "--no-browser", "--port", "0", "--camera", "twin:small", work]
    with (
        (folder / "stderr").open("w+b") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True) as process,
    ):
        assert process.stdout is not None
        line = process.stdout.readline().strip()
        studio = Running(line.rstrip("/"), work)
        children: list[psutil.Process] = []
        try:
            found.check("starts over a workspace of damaged files", holds=bool(line))
            studio.until("live", lambda live: live["running"])
            children = psutil.Process(process.pid).children(recursive=True)
            run_all(studio, found)
            size = psutil.Process(process.pid).memory_info().rss / 1e6
            found.check("memory of the server", holds=size < 400, shown=f"{size:.0f} MB")
        finally:
            process.send_signal(signal.SIGINT)
            with suppress(subprocess.TimeoutExpired):
                process.wait(20)
            for each in children:
                with suppress(psutil.NoSuchProcess):
                    each.kill()
            process.kill()
        found.check("Ctrl-C ends it", holds=process.returncode == 130, shown=process.returncode)
        errors.seek(0)
        said = errors.read().decode("utf-8", "replace")
        found.check(
            "no traceback on standard error",
            holds="Traceback" not in said and "Exception in" not in said,
            shown=said[-2000:] if "Traceback" in said else "",
        )
    return found


def run_all(studio: Running, found: Attacked) -> None:
    attacks: dict[str, Callable[[Running, Attacked], None]] = {
        "damaged files": damaged_files,
        "requests": requests,
        "links": links,
        "200 jobs at once": many_jobs,
        "large frame of a webcam": large_frame,
        "a flood of ok": flood,
        "messages that are no text": no_text,
        "early answers": early_answers,
    }
    with looked_at(studio) as pages, probed(studio, found) as attack:
        begun = time.monotonic()
        for name, run in attacks.items():
            attack(name)
            run(studio, found)
            seen = shown_more(pages)
            found.check(f"all pages are shown frames: {name}", holds=seen)
        print(f"     {sum(pages.values()) / (time.monotonic() - begun) / (PAGES - 1):.1f} frames/s")


# The workspace.


def prepare(work: Path, folder: Path) -> None:
    """A workspace with thousands of files, damaged ones, and links out of it."""
    for name in ("uploads", "cameras", "jobs", "sequence"):
        (work / name).mkdir(parents=True)
    random = np.random.default_rng(0)
    np.save(work / "raw.npy", random.random((64, 80), np.float32))
    np.save(work / "long.npy", random.random((480, 640), np.float32))
    np.save(work / "long-psf.npy", (random.random((480, 640)) < 1e-3).astype(np.float32))
    np.save(work / "psf.npy", (random.random((64, 80)) < 0.01).astype(np.float32))
    for number in range(3000):
        (work / f"uploads/{number}.npy").touch()
        (work / f"{number}.json").touch()
    for number in range(200):
        camera = work / f"cameras/{number}"
        camera.mkdir()
        (camera / "camera.toml").write_text(f'name = "{number}"\nnote = "a note"\n')
    for name, content in BAD_TOML.items():
        for file in ("camera.toml", "psfs.toml"):
            camera = work / f"cameras/bad-{name}-{file[:3]}"
            camera.mkdir()
            (camera / file).write_bytes(content)
    for name, content in BAD_JSON.items():
        for place in (f"jobs/{name}/job.json", f"{name}.json"):
            (work / place).parent.mkdir(exist_ok=True)
            (work / place).write_bytes(content)
    outside = folder / "outside"
    outside.mkdir()
    np.save(outside / "secret.npy", random.random((64, 80), np.float32))
    (outside / "camera.toml").write_text(f'note = "{SECRET}"\n')
    (outside / "job.json").write_text(json.dumps({"id": "linked", "title": SECRET}))
    for link, target in {
        "sequence/1.npy": "secret.npy", "secret.npy": "secret.npy", "away": "",
        "cameras/linked/camera.toml": "camera.toml", "jobs/linked/job.json": "job.json",
    }.items():  # fmt: skip
        (work / link).parent.mkdir(exist_ok=True)
        (work / link).symlink_to(outside / target)


BAD_TOML = {
    "deep": b"a = " + b"[" * 3000 + b"]" * 3000,
    "digits": b"a = " + b"9" * 5000,
    "types": b"psf = 3\nnote = []\n",
    "angle": b'psf = [{file = "x.tif", angle = 3}]\nnote = [1]\n',
    "name": b'psf = [{file = "../../../etc/passwd"}]\nnote = 1\n',
    "binary": bytes(range(256)),
    "zeros": b"\0" * 100_000,
}
BAD_JSON = {
    "deep": b"[" * 100_000,
    "digits": b'{"id": ' + b"9" * 5000 + b"}",
    "empty": b"",
    "surrogate": rb'{"id": "surrogate", "kind": "psf", "title": "\ud800", "status": "done"}',
    "nan": b'{"id": "nan", "kind": "psf", "title": "x", "status": "done", "started": NaN}',
    "types": b'{"id": "types", "kind": "psf", "title": [], "status": 1, "history": {}}',
    "binary": bytes(range(256)),
    "kind": b'{"id": "kind", "kind": "no", "title": "x", "status": "done"}',
}


# The attacks.


def damaged_files(studio: Running, found: Attacked) -> None:
    cameras = {each["id"]: each["trouble"] for each in studio.get("about")["cameras"]}
    bad = [name for name in cameras if "/bad-" in name and cameras[name]]
    parsed = {"deep", "digits", "binary", "zeros"}
    expected = {f"work/cameras/bad-{name}-psf" for name in BAD_TOML}
    expected |= {f"work/cameras/bad-{name}-cam" for name in parsed}
    found.check("bad cameras are shown with a reason", holds=expected <= {*bad}, shown=len(bad))
    jobs = {each["id"]: each["error"] for each in studio.get("jobs")["jobs"]}
    found.check("bad jobs are shown with a reason", holds=all(jobs.get(name) for name in BAD_JSON))
    found.check(
        "links of cameras and jobs are not followed",
        holds=SECRET not in json.dumps([studio.get("about"), studio.get("jobs")]),
    )


def requests(studio: Running, found: Attacked) -> None:
    """Bodies, headers, paths: each is answered with 4xx in one line, or as it should be."""
    wrong, count = [], 0
    port = int(studio.url.rsplit(":", 1)[1])
    for target, head, body in odd_requests():
        count += 1
        status, text = raw(port, target, head, body)
        one_line = "Traceback" not in text and "a bug in nolens" not in text
        if not (200 <= status < 500) or not one_line:
            wrong.append((target[:60], head[:60], body[:60], status, text[-200:]))
    found.check(f"{count} odd requests", holds=not wrong, shown=wrong)
    settings = {"method": "admm", "detail": 1.0, "iterations": 2, "exposure_s": None}
    studio.post("live/start", {"source": "twin:small", "settings": settings})
    cancel_all(studio)  # Some of them can be done, and take long.
    identity = studio.job("reconstruct", SHORT)
    job = studio.ended(identity)
    found.check("a job runs after them", holds=job["status"] == "done", shown=job["error"] or "")


def odd_requests() -> Iterator[tuple[str, str, bytes]]:
    """Target, headers and body of requests; those with a body are POST."""
    odd = ["\\ud800", "\\u0000", "x" * 300_000, "../" * 300, "work/" + "a/" * 400, "\\n\\u001b[31m"]
    values = [f'"{each}"' for each in odd]
    values += [
        "9" * 5000,
        "9" * 90,
        "-1",
        "1e999",
        "NaN",
        "[" * 900 + "]" * 900,
        "[" * 30 + "]" * 30,
    ]
    values += [
        "{}",
        "[]",
        "null",
        "true",
        "[" + '"work/raw.npy",' * 5000 + '"x"]',
        '{"a":' * 20 + "1" + "}" * 20,
    ]
    options = {
        "psf": ("camera", "light", "depth", "angle"), "reconstruct": ("measurement", "psf", "tau"),
        "calibrate": ("name", "frames", "distance"), "calibrate-import": ("psfs", "distance"),
        "design-look": ("thickness",),
        "design-thickness": ("material", "name"), "fabricate": ("tolerances", "thickness"),
        "refocus": ("psfs", "measurement"), "preview": ("path",), "measure-field": ("dots",),
    }  # fmt: skip
    for value in values:
        for kind, names in options.items():
            for name in names:
                yield post("jobs", f'{{"kind": "{kind}", "options": {{"{name}": {value}}}}}')
        yield post("jobs", f'{{"kind": {value}, "options": {value}}}')
        for name in (
            "detail",
            "iterations",
            "over_field",
            "trained",
            "exposure_s",
            "frozen",
            "method",
        ):
            yield post("live/settings", f'{{"{name}": {value}}}')
        for name in ("source", "psf"):
            yield post("live/start", f'{{"source": "nothing", "{name}": {value}}}')
        yield post("live/scene", f'{{"builtin": {value}}}')
        yield post("live/save", f'{{"as": {value}}}')
        yield post("jobs", value)
    yield post("jobs", '{"\\ud800": 1}')
    yield post("jobs", '{"kind": "psf", "options": {"' + "k" * 900_000 + '": 1}}')
    yield post("jobs", b"\xff\xfe\x00")
    yield post("jobs", "1" * 1_500_000)
    yield post("jobs", "{}", "Content-Type: application/json; charset=\xff")
    yield post("jobs", "{}", "Content-Encoding: gzip")
    yield post("live/scene", b"\x89PNG\r\n\x1a\n" + b"x" * 1000, "Content-Type: image/png")
    for path in (
        "%00",
        "%ed%a0%80",
        "%ff",
        "a" * 5000,
        "..%2f..%2fetc%2fpasswd",
        "%0a%0d",
        "\\..\\..",
        "//",
        "work%2f%00",
        "work/away/secret.npy",
        "work/secret.npy",
        "%E2%80%AE",
    ):
        for route in ("/", "/api/", "/api/jobs/", "/api/file?path=", "/api/files?path=", "/js/"):
            yield f"{route}{path}", "", b""
        yield f"/api/uploads?name={path}", "Content-Length: 1", b"x"
    for head in (
        f"Content-Length: {'9' * 5000}",
        "Content-Length: -1",
        "Transfer-Encoding: x",
        "Range: bytes=a-b",
        "Range: bytes=" + "0-1," * 1000 + "0-1",
        "Range: bytes=5-1",
        "Cookie: \xff=\xff; =;",
        "Origin: \xff",
        "Host: [",
        "Sec-Fetch-Site: \x80",
        f"X: {'y' * 60_000}",
        f"X: {'y' * 300_000}",
        "If-Range: \xff",
        "If-None-Match: \xff",
        "If-Modified-Since: never",
        "Accept: \xff",
        "Content-Type: \xff",
        "Upgrade: websocket\r\nConnection: Upgrade",
        "Expect: 100-continue\r\nContent-Length: 5",
    ):
        yield "/", head, b""
        yield "/api/file?path=work/raw.npy", head, b""


def post(path: str, body: str | bytes, head: str = "Content-Type: application/json") -> Any:
    data = body.encode() if isinstance(body, str) else body
    return f"/api/{path}", f"{head}\r\nContent-Length: {len(data)}", data


def raw(port: int, target: str, head: str, body: bytes, *, seconds: float = 60) -> tuple[int, str]:
    """Status and text of an answer, of a client that sends all before it reads."""
    method = "POST" if body else "GET"
    lines = [f"{method} {target} HTTP/1.1", f"Host: 127.0.0.1:{port}", "Connection: close"]
    lines += [head] if head else []
    if head.startswith("Host"):
        lines.pop(1)
    with socket.create_connection(("127.0.0.1", port), seconds) as line:
        received = b""
        with suppress(ConnectionError):  # What was answered before is read all the same.
            line.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
            for start in range(0, len(body), 65536):
                line.sendall(body[start : start + 65536])
        with suppress(ConnectionError):
            while piece := line.recv(65536):
                received += piece
    received = received.removeprefix(b"HTTP/1.1 100 Continue\r\n\r\n")
    status = received[9:12]
    return int(status) if status.isdigit() else 0, received.decode("latin-1")


def links(studio: Running, found: Attacked) -> None:
    """Links inside folders that jobs read: frames of a sequence, PSFs of a list."""
    camera = studio.work / "cameras/psfs"
    camera.mkdir()
    (camera / "psfs.toml").write_text(
        'schema_version = 1\n[[psf]]\nfile = "x.tif"\npixel = "3.1 um"\nchannels = ["grey"]\n'
        'distance = "300 mm"\n'
    )
    (camera / "x.tif").symlink_to(studio.work.parent / "outside/secret.npy")
    asked: list[tuple[str, dict[str, Any]]] = [
        ("preview", {"path": "work/secret.npy"}),
        ("preview", {"path": "work/away/secret.npy"}),
        ("preview", {"path": "work/sequence"}),
        ("reconstruct", {**SHORT, "measurement": "work/sequence"}),
        ("refocus", {"measurement": "work/raw.npy", "psfs": "work/cameras/psfs"}),
        ("psf", {"camera": "work/cameras/linked"}),
    ]
    for kind, options in asked:
        answer = httpx.post(
            f"{studio.url}/api/jobs", json={"kind": kind, "options": options}, timeout=90
        )
        said = answer.json().get("detail", "")
        if answer.status_code == 201:
            job = studio.ended(answer.json()["id"])
            said = job["error"] or f"it is {job['status']}"
        found.check(f"{kind} {options}", holds="which is not followed" in said, shown=said)


def many_jobs(studio: Running, found: Attacked) -> None:
    running = studio.job("reconstruct", LONG)
    studio.until(f"jobs/{running}", lambda job: job["status"] == "running")

    # By bare sockets: two hundred clients of Python would take the processors from the studio.
    port = int(studio.url.rsplit(":", 1)[1])
    target, head, body = post("jobs", json.dumps({"kind": "reconstruct", "options": SHORT}))
    asked = f"POST {target} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n{head}"
    lines = [socket.create_connection(("127.0.0.1", port), PATIENCE_S) for _ in range(JOBS)]
    for line in lines:
        line.sendall(asked.encode() + b"\r\n\r\n" + body)
    answers = [(int(text[9:12]), text) for text in map(received, lines)]
    counts = Counter(status for status, _ in answers)
    found.check(
        f"{JOBS} jobs at once",
        holds=counts == {201: WAITING, 429: JOBS - WAITING},
        shown=", ".join(f"{count} × {status}" for status, count in sorted(counts.items())),
    )
    said = {text for status, text in answers if status == 429}
    found.check("the others are told why", holds=all("waiting already" in text for text in said))
    jobs = studio.get("jobs")["jobs"]
    waiting = [each["id"] for each in jobs if each["status"] == "queued"]
    found.check("so many wait", holds=len(waiting) == WAITING, shown=len(waiting))
    cancel_all(studio)


def received(line: socket.socket) -> str:
    """All that comes, to the end."""
    text = b""
    with line:
        while piece := line.recv(65536):
            text += piece
    return text.decode("latin-1")


def cancel_all(studio: Running) -> None:
    jobs = studio.get("jobs")["jobs"]
    unended = [each["id"] for each in jobs if each["status"] in ("queued", "running")]
    for identity in unended:
        studio.post(f"jobs/{identity}/cancel")
    for identity in unended:
        studio.ended(identity)


def large_frame(studio: Running, found: Attacked) -> None:
    buffer = BytesIO()
    Image.new("L", (7000, 7000)).save(buffer, "PNG")
    with connect(studio.frames, max_size=None) as page:
        for _ in range(20):
            page.send(buffer.getvalue())
            page.recv(timeout=20)
            page.send("ok")
        said = studio.until("live", lambda live: live["error"])["error"]
        found.check("a large frame of a webcam is refused", holds="megapixels" in said, shown=said)
    studio.post("live/scene", {"builtin": "chart"})


def flood(studio: Running, found: Attacked) -> None:
    """As many "ok" as one connection takes, for some seconds: the others see as much."""
    fps = frames_per_s(studio)
    port = int(studio.url.rsplit(":", 1)[1])
    with socket.create_connection(("127.0.0.1", port), 1) as line:
        line.sendall(
            f"GET /api/live/frames HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\n"
            "Connection: Upgrade\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n"
            "Sec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        line.recv(100)
        ends = threading.Event()

        def send() -> None:
            oks = 10_000 * (bytes((0x81, 0x82, 0, 0, 0, 0)) + b"ok")
            while not ends.is_set():
                with suppress(TimeoutError):
                    line.sendall(oks)

        thread = threading.Thread(target=send)
        thread.start()
        flooded = frames_per_s(studio)
        ends.set()
        thread.join()
    found.check(
        'a flood of "ok" leaves the others their frames', holds=flooded > fps / 2,
        shown=f"{fps:.1f} frames/s before, {flooded:.1f} meanwhile",
    )  # fmt: skip


def frames_per_s(studio: Running, seconds: float = 4) -> float:
    count = 0
    with connect(studio.frames, max_size=None) as page:
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            page.recv(timeout=20)
            page.send("ok")
            count += 1
    return count / seconds


def no_text(studio: Running, found: Attacked) -> None:
    ends = []
    for data, text in ((b"\xff\xfe", True), ("okay", None), (b"no picture", None), (b"", None)):
        with connect(studio.frames, max_size=None) as page, suppress(ConnectionClosed):
            page.send(data, text=text)
            try:
                while True:
                    page.recv(timeout=20)
            except ConnectionClosedError as error:
                ends.append(error.rcvd.code if error.rcvd is not None else None)
    found.check(
        "what is no text closes its socket", holds=ends == [1007, 1008, 1008, 1008], shown=ends
    )


def early_answers(studio: Running, found: Attacked) -> None:
    """Refused before it is all sent: the client sees why, and no connection is reset."""
    port = int(studio.url.rsplit(":", 1)[1])
    body = bytes(50_000_000)
    for target in ("/api/jobs", "/api/uploads?name=x.exe", "/api/live/scene"):
        status, text = raw(port, target, f"Content-Length: {len(body)}", body)
        detail = text.partition('"detail":')[2]
        found.check(
            f"refused early: {target}", holds=status in (413, 422), shown=f"{status} {detail}"
        )


# Who looks on.


@contextmanager
def looked_at(studio: Running) -> Iterator[Counter[int]]:
    """So many pages, one of which never reads; how many frames each has seen."""
    pages: Counter[int] = Counter()
    ends = threading.Event()

    def look(number: int) -> None:
        with connect(studio.frames, max_size=None) as page:
            while not ends.is_set():
                with suppress(TimeoutError):
                    page.recv(timeout=1)
                    page.send("ok")
                    pages[number] += 1

    threads = [threading.Thread(target=look, args=(number,)) for number in range(PAGES - 1)]
    with connect(studio.frames, max_size=None, max_queue=1) as stopped:
        stopped.send("ok")
        for thread in threads:
            thread.start()
        try:
            yield pages
        finally:
            ends.set()
            for thread in threads:
                thread.join(20)


def shown_more(pages: Counter[int]) -> bool:
    """Whether every page that reads is shown another frame."""
    before, end = Counter(pages), time.monotonic() + PATIENCE_S
    while time.monotonic() < end:
        if all(pages[number] > before[number] for number in range(PAGES - 1)):
            return True
        time.sleep(0.1)
    return False


@contextmanager
def probed(studio: Running, found: Attacked) -> Iterator[Callable[[str], None]]:
    """Ask what the page asks first, again and again, from a process of its own."""
    marks: list[tuple[float, str]] = [(0.0, "before")]
    with subprocess.Popen(
        [sys.executable, __file__, "--probe", studio.url], stdin=subprocess.PIPE,
        stdout=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            yield lambda name: marks.append((time.time(), name))
        finally:
            out, _ = process.communicate("\n", timeout=30)
    for at, taken, late in json.loads(out):
        found.milliseconds.append((max(mark for mark in marks if mark[0] <= at)[1], taken))
        found.late.append(late)


def probe(url: str) -> None:
    """Times of requests until a line comes, what each took, and how late it was begun, in ms.

    The last says how busy the machine is with something else.
    """
    ends = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), ends.set()), daemon=True).start()
    times = []
    with httpx.Client(timeout=PATIENCE_S) as client:
        while not ends.is_set():
            asleep = time.perf_counter()
            time.sleep(PAUSE_S)
            begun, at = time.perf_counter(), time.time()
            client.get(f"{url}/api/about").raise_for_status()
            taken = time.perf_counter() - begun
            times.append((at, 1e3 * taken, 1e3 * (begun - asleep - PAUSE_S)))
    print(json.dumps(times))


if __name__ == "__main__":
    os.environ["OMP_NUM_THREADS"] = "1"
    sys.exit(main())
