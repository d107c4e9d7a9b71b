"""A studio that runs: in this process, or by its command in one of its own."""

import contextlib
import ctypes
import os
import signal
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import psutil
import uvicorn
from fastapi import FastAPI

from nolens.files.weights import write_weights
from nolens.solvers.denoising_network import DenoisingNetwork
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.studio.app import Studio, create_app
from nolens.studio.serve import configuration, listen
from nolens.studio.workspace import Workspace
from patience import PATIENCE_S

NOLENS = Path(sys.executable).with_name("nolens")
_SET_DEATH_SIGNAL = 1
"""Of prctl(2)."""
_NO_TLS = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
"""httpx would read all certificates of the system for every request."""
_PRCTL = getattr(ctypes.CDLL(None), "prctl", None)


def with_the_tests() -> None:
    """In a process that starts: end it with the tests, also where those are killed (on Linux)."""
    if _PRCTL is not None:
        _PRCTL(_SET_DEATH_SIGNAL, signal.SIGKILL)


@dataclass
class Running:
    """A studio that answers."""

    url: str
    work: Path
    said: list[str] = field(default_factory=list)
    app: FastAPI | None = None

    @property
    def frames(self) -> str:
        """Address of the live view's frames."""
        return self.url.replace("http", "ws", 1) + "/api/live/frames"

    def get(self, path: str, **how: Any) -> Any:
        """JSON of a GET that must succeed."""
        answer = httpx.get(f"{self.url}/api/{path}", timeout=PATIENCE_S, verify=_NO_TLS, **how)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def post(self, path: str, given: Any = None, status: int = 200, **how: Any) -> Any:
        """JSON of a POST with this outcome."""
        answer = httpx.post(
            f"{self.url}/api/{path}", json=given, timeout=PATIENCE_S, verify=_NO_TLS, **how
        )
        assert answer.status_code == status, answer.text
        return answer.json()

    def job(self, kind: str, options: dict[str, Any]) -> str:
        """Start a job."""
        return str(self.post("jobs", {"kind": kind, "options": options}, 201)["id"])

    def ended(self, identity: str) -> dict[str, Any]:
        """A job, once it has ended."""
        return self.until(
            f"jobs/{identity}", lambda job: job["status"] in ("done", "failed", "cancelled")
        )

    def until(self, path: str, true: Any) -> dict[str, Any]:
        """What a path answers, once something is true of it."""
        end = time.monotonic() + PATIENCE_S
        while True:
            found: dict[str, Any] = self.get(path)
            if true(found):
                return found
            assert time.monotonic() < end, found
            time.sleep(0.05)


@contextlib.contextmanager
def serving(work: Path, *more: Path, source: str | None = None, **how: Any) -> Iterator[Running]:
    """A studio in this process, on a port of its own."""
    said: list[str] = []
    studio = Studio(Workspace([work, *more]), source=source, say=said.append, **how)
    app = create_app(studio)
    socket = listen("127.0.0.1", 0, said.append)
    server = uvicorn.Server(configuration(app))
    thread = threading.Thread(target=server.run, args=([socket],))
    thread.start()
    try:
        while not server.started:
            time.sleep(0.01)
        yield Running(f"http://127.0.0.1:{socket.getsockname()[1]}", work, said, app)
    finally:
        server.should_exit = True
        thread.join(PATIENCE_S)
        assert not thread.is_alive()


@contextlib.contextmanager
def command(*arguments: object) -> "Iterator[subprocess.Popen[str]]":
    """`nolens studio` in a process of its own."""
    with subprocess.Popen(
        [NOLENS, "studio", "--no-browser", *map(str, arguments)], stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, env={**os.environ, "OMP_NUM_THREADS": "1"},
        preexec_fn=with_the_tests,
    ) as process:  # fmt: skip
        try:
            yield process
        finally:
            with contextlib.suppress(psutil.NoSuchProcess):
                for child in psutil.Process(process.pid).children(recursive=True):
                    child.kill()
            process.kill()


def write_own_weights(path: Path) -> Path:
    """A small prior, as `nolens train` writes one."""
    network = DenoisingNetwork((8,), (1,))
    write_weights(path, PlugAndPlay(network, (0.1,), {"prior": "denoiser"}), {})
    return path


def stop(process: "subprocess.Popen[str]") -> tuple[int, str]:
    """Press Ctrl-C; exit code and standard error."""
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=PATIENCE_S)
    return process.returncode, err
