"""How run.py and its workers talk: a JSON line asks, a JSON line answers. Standard library."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

COMMANDS = frozenset({"about", "load", "iterate", "trace", "peak", "drop"})


class WorkerError(RuntimeError):
    """A worker answered with an error or stopped."""


class WorkerKilledError(WorkerError):
    """A worker was killed from outside, as Linux does where memory runs out."""


class Worker:
    """A worker process on run.py's side; use it with `with`."""

    def __init__(self, name: str, command: list[str | Path], env: Mapping[str, str]) -> None:
        self.name = name
        self._process = subprocess.Popen(
            [str(part) for part in command],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, **env},
        )

    def ask(self, do: str, **arguments: Any) -> dict[str, Any]:
        """Send one command and wait for its answer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):  # the empty answer below says it
            self._process.stdin.write(json.dumps({"do": do, **arguments}) + "\n")
            self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            code = self._process.wait()
            if code == -signal.SIGKILL:
                raise WorkerKilledError(f"{self.name} was killed at {do!r}: out of memory")
            raise WorkerError(f"{self.name} stopped with code {code} at {do!r}")
        answer: dict[str, Any] = json.loads(line)
        if "error" in answer:
            raise WorkerError(f"{self.name} at {do!r}: {answer['error']}")
        return answer

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        with contextlib.suppress(BrokenPipeError):
            self._process.stdin.close()
        try:
            self._process.wait(timeout=10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._process.stdout.close()


def serve(side: object) -> None:
    """Answer commands by the side's methods until input ends; other output goes to stderr."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    for line in sys.stdin:
        command = json.loads(line)
        do = command.pop("do")
        assert do in COMMANDS, do
        try:
            answer = getattr(side, do)(**command)
        except Exception as error:  # one bad command must be told, not end the run in silence
            answer = {"error": f"{type(error).__name__}: {error}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def peak_mib() -> float:
    """The most memory this process has held (ru_maxrss: KiB on Linux, bytes on macOS)."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20
