"""A studio in a process of its own, and requests to it."""

import json
import os
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path
from typing import Any

import httpx
import psutil
from executor import MEMORY_BYTES, SECONDS, Outcome

_NOLENS = Path(sys.executable).with_name("nolens")


class Server:
    """`nolens studio` on a port of its own.

    Parameters
    ----------
    work
        Folder that it writes into.
    """

    def __init__(self, work: Path) -> None:
        frames = work.with_name("no-frames")  # A watched folder without frames costs nothing.
        frames.mkdir(parents=True, exist_ok=True)
        self._errors = tempfile.NamedTemporaryFile(prefix="nolens-fuzz-")  # noqa: SIM115
        self._process = subprocess.Popen(
            [
                _NOLENS,
                "studio",
                str(work),
                "--no-browser",
                "--port",
                "0",
                "--camera",
                f"folder:{frames}",
            ],
            stdout=subprocess.PIPE,
            stderr=self._errors,
            env={**os.environ, "OMP_NUM_THREADS": "1"},
        )
        assert self._process.stdout is not None
        line = b""
        while b"http://" not in line:
            line = self._process.stdout.readline()
            if not line:
                raise RuntimeError("the studio did not start: " + self._err())
        url = line[line.index(b"http://") :].split()[0].decode().rstrip("/.,")
        self._client = httpx.Client(base_url=url, timeout=SECONDS)
        # Its processes load the program first.
        first = {"kind": "psf", "options": {"camera": "none"}}
        self._client.post("/api/jobs", json=first, timeout=10 * SECONDS)

    def request(self, method: str, path: str, body: Any) -> Outcome:
        """Send one request; an error of the server's, silence or a dead server is trouble."""
        if path.startswith("jobs") and isinstance(body, dict):
            self._cancel_all()
        trouble, status = None, None
        try:
            content = json.dumps(body).encode("utf-8", "surrogatepass")
            answer = self._client.request(
                method,
                f"/api/{path}",
                content=content,
                headers={"content-type": "application/json"},
            )
            status = answer.status_code
            if status >= 500 and status != 507:
                trouble = f"status {status}"
        except (httpx.InvalidURL, ValueError):
            return Outcome("never sent", "", 0, (), None)  # No client can send it.
        except httpx.TimeoutException:
            trouble = "hang"
        except httpx.HTTPError as error:
            trouble = f"no answer: {type(error).__name__}"
        err = self._err()
        if trouble is None and "Traceback" in err:
            trouble = "a traceback on standard error"
        if trouble is None and self._bytes() > MEMORY_BYTES:
            trouble = "memory"
        self._errors.truncate(0)
        return Outcome(status, err, 0, (), trouble)

    def close(self) -> Outcome | None:
        """Stop it as Ctrl-C does; an outcome if that is trouble."""
        self._client.close()
        children = psutil.Process(self._process.pid).children(recursive=True)
        self._process.send_signal(signal.SIGINT)
        try:
            code = self._process.wait(SECONDS)
        except subprocess.TimeoutExpired:
            self._process.kill()
            code = None
        for each in children:
            with suppress(psutil.NoSuchProcess):
                each.kill()
        err = self._err()
        if code in (0, 130) and "Traceback" not in err:
            return None
        return Outcome(code, err, 0, (), f"it ended with exit code {code}")

    def _cancel_all(self) -> None:
        with suppress(httpx.HTTPError, ValueError, KeyError):
            for job in self._client.get("/api/jobs").json()["jobs"]:
                if job["status"] in ("queued", "running"):
                    self._client.post(f"/api/jobs/{job['id']}/cancel")

    def _bytes(self) -> int:
        with suppress(psutil.NoSuchProcess):
            process = psutil.Process(self._process.pid)
            every = [process, *process.children(recursive=True)]
            return max(int(each.memory_info().rss) for each in every)
        return 0

    def _err(self) -> str:
        return Path(self._errors.name).read_bytes().decode("utf-8", "replace")
