"""Ways to run the command, and to see what it left behind."""

import contextlib
import hashlib
import io
import os
import re
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from torch import Tensor

from nolens.cli.main import main
from nolens.files import read_frame
from patience import PATIENCE_S

NOLENS = Path(sys.executable).with_name("nolens")
"""The installed command."""


@dataclass(frozen=True)
class Done:
    code: int
    out: str
    err: str


def run(*arguments: object) -> Done:
    """The command in this process; what it does not catch is raised."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main([str(each) for each in arguments])
        except SystemExit as left:
            assert isinstance(left.code, int)
            code = left.code
    return Done(code, out.getvalue(), err.getvalue())


class Started(subprocess.Popen):  # type: ignore[type-arg]
    """A process that goes with the test that started it."""

    def __exit__(self, *about: object) -> None:
        self.kill()
        super().__exit__(*about)


def start(*arguments: object, **how: object) -> Started:
    """The installed command, in a process of its own."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, **how}
    given["env"] = {**os.environ, "OMP_NUM_THREADS": "1", **dict(given.get("env") or {})}  # type: ignore[call-overload]
    return Started([str(NOLENS), *map(str, arguments)], **given)


def command(*arguments: object, **how: object) -> Done:
    """The installed command, to its end."""
    with start(*arguments, **how) as process:
        out, err = process.communicate(timeout=PATIENCE_S)
    return Done(process.returncode, out or "", err or "")


def reconstruct(output: Path, *arguments: object) -> Tensor:
    """The picture that `nolens reconstruct` writes as float TIFF, (channels, height, width)."""
    done = run("reconstruct", *arguments, "-o", output, "--tiff-bits", 32)
    assert done.code == 0, done.err
    return read_frame(output).counts


def listing(folder: Path) -> dict[str, str]:
    """All files below a folder, with their content."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        if path.is_file()
        else "folder"
        for path in sorted(folder.rglob("*"))
    }


def check_refused(done: Done, *words: str) -> None:
    """Exit code 2 and one message on standard error that says all of the words."""
    assert done.code == 2, done
    assert done.out == ""
    assert "Traceback" not in done.err
    assert done.err.startswith("nolens: ") and done.err.endswith("\n")
    assert done.err.count("\n") == 1, done.err
    for word in words:
        assert word in done.err, f"{word!r} is missing in: {done.err}"


def read_terminal(descriptor: int, until: str) -> str:
    """What was shown on a pseudo-terminal, until a pattern is seen or it is closed."""
    shown, end = "", time.monotonic() + PATIENCE_S
    while time.monotonic() < end and not (until and re.search(until, shown)):
        if not select.select([descriptor], [], [], 1)[0]:
            continue
        try:
            data = os.read(descriptor, 65536)
        except OSError:  # Linux says this when the other side is closed.
            break
        if not data:
            break
        shown += data.decode()
    return shown
