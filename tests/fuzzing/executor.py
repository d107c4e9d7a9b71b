"""Runs a command in a forked process that may die, hang or take too much memory."""

import os
import resource
import shutil
import signal
import socket
import sys
import tempfile
import traceback
import unicodedata
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from readers import READERS

from nolens.errors import NolensError

SECONDS = 20.0
"""Longest time for one command."""
MEMORY_BYTES = 3 * 2**30
"""Most memory that one command may take beyond what the program takes."""
_FEW = 250
_ACCEPTED = (0, 2, 3, 130)
_CONTROL = ("Cc", "Cf", "Cs", "Zl", "Zp")


@dataclass(frozen=True)
class Outcome:
    """What one command did.

    Parameters
    ----------
    code
        Exit code; None where there was none: it was killed, or died.
    err
        What it wrote on standard error.
    bytes
        Most memory it took beyond what the program had.
    left
        Files in its output folder afterwards.
    trouble
        What is wrong with that: the place of a traceback, a hang; None if nothing is.
    """

    code: int | None
    err: str
    bytes: int
    left: tuple[str, ...]
    trouble: str | None


class Executor:
    """A process forked from this one, which has loaded all of the program and computed nothing."""

    def __init__(self) -> None:
        import nolens.cli.app
        import nolens.jobs  # noqa: F401

        self._folder = Path(tempfile.mkdtemp(prefix="nolens-fuzz-"))
        self._pid = 0
        self._done = 0

    def run(self, arguments: list[str], folder: Path) -> Outcome:
        """Run ``nolens ARGUMENTS``.

        Parameters
        ----------
        arguments
            Of the command.
        folder
            Its working folder; what it writes below ``out`` there is taken away again.
        """
        if not self._pid or self._done >= _FEW:
            self.close()
            self._fork()
        self._done += 1
        out = folder / "out"
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        try:
            self._pipe.send((arguments, str(folder)))
            if not self._pipe.poll(SECONDS):
                err = self._err()
                self.close()
                return self._outcome(None, err, 0, out, "hang")
            code, place, used = self._pipe.recv()
        except (EOFError, OSError):
            err = self._err()
            _, status = os.waitpid(self._pid, 0)
            self._pid = 0
            return self._outcome(None, err, 0, out, f"died: status {status}")
        return self._outcome(code, self._err(), used, out, place)

    def close(self) -> None:
        """End the process."""
        if self._pid:
            with suppress(ProcessLookupError):
                os.kill(self._pid, signal.SIGKILL)
            os.waitpid(self._pid, 0)
            self._pid = 0

    def _err(self) -> str:
        with suppress(OSError):
            return (self._folder / "stderr").read_bytes().decode("utf-8", "replace")
        return ""

    def _outcome(
        self, code: int | None, err: str, used: int, out: Path, place: str | None
    ) -> Outcome:
        left = tuple(sorted(str(each.relative_to(out)) for each in out.rglob("*")))
        trouble = place or _trouble(code, err, used, left)
        return Outcome(code, err, used, left, trouble)

    def _fork(self) -> None:
        self._done = 0
        self._pipe, theirs = Pipe()
        sys.stdout.flush()
        self._pid = os.fork()
        if self._pid:
            theirs.close()
            return
        try:
            self._pipe.close()
            _serve(theirs, self._folder / "stderr")
        finally:
            os._exit(0)


def _trouble(code: int | None, err: str, used: int, left: tuple[str, ...]) -> str | None:
    """What is wrong with how a command ended."""
    lines = err.splitlines()
    if code not in _ACCEPTED:
        return f"exit code {code}"
    if code and not any(line.startswith("nolens: ") for line in lines):
        return f"exit code {code} without a message"
    if code == 2 and left:
        return f"exit code 2, but it wrote {left[0]}"
    if used > MEMORY_BYTES:
        return f"memory: {used / 2**30:.1f} GiB"
    if any(unicodedata.category(each) in _CONTROL and each not in "\n\t" for each in err):
        return "control characters on the terminal"
    if code == 2 and (len(lines) > 12 or len(err) > 3000):
        return f"a message of {len(lines)} lines and {len(err)} characters"
    for word in ("Traceback", "allow_pickle", "object at 0x", "Warning:"):
        if word in err:
            return f"the message has {word!r} in it"
    return None


def _serve(pipe: Connection, errors: Path) -> None:
    """Run what comes, until the other side is gone."""
    from nolens.cli.main import main

    socket.socket.connect = _no_network  # type: ignore[assignment, method-assign]
    limit = _status("VmSize") + MEMORY_BYTES + 2**28
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    nowhere = os.open(os.devnull, os.O_RDWR)
    os.dup2(nowhere, 0)
    os.dup2(nowhere, 1)
    while True:
        try:
            arguments, folder = pipe.recv()
        except EOFError:
            return
        os.chdir(folder)
        target = os.open(errors, os.O_CREAT | os.O_TRUNC | os.O_WRONLY, 0o600)
        os.dup2(target, 2)
        os.close(target)
        Path("/proc/self/clear_refs").write_text("5")  # The high-water mark starts again.
        before = _status("VmRSS")
        place = None
        code: int | None = 1
        try:
            if arguments[0].startswith("@"):
                READERS[arguments[0]](Path(arguments[1]))
                code = 0
            else:
                main(arguments)
        except SystemExit as left:
            code = left.code if isinstance(left.code, int) else None
        except NolensError as error:
            sys.stderr.write(f"nolens: {error}\n")
            code = 2
        except BaseException as error:
            place = f"{type(error).__name__} at {_place(error)}"
            traceback.print_exc()
        sys.stderr.flush()
        pipe.send((code, place, max(0, _status("VmHWM") - before)))


def _no_network(*_: object) -> None:
    raise AssertionError("a command reached for the network")


def _place(error: BaseException) -> str:
    """The last line of ours that the error came through."""
    ours = [
        each for each in traceback.extract_tb(error.__traceback__) if "/nolens/" in each.filename
    ]
    if not ours:
        return "?"
    return f"{ours[-1].filename.rpartition('/nolens/')[2]}:{ours[-1].lineno}"


def _status(name: str) -> int:
    """Bytes of a line of this process's status."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    return 0
