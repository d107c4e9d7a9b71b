"""The command with packages installed beside it, which count when a process starts: it is one
process for many commands.
"""

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

INSTALLED = Path(__file__).parent / "installed"
ANSWER = """
import contextlib, io, json, os, sys
from nolens.cli.main import main

for line in sys.stdin:
    folder, arguments = json.loads(line)
    os.chdir(folder)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            main(arguments)
        except SystemExit as left:
            code = left.code
    print(json.dumps([code, out.getvalue(), err.getvalue()]), flush=True)
"""


@dataclass(frozen=True)
class Done:
    returncode: int
    stdout: str
    stderr: str

    @property
    def printed(self) -> str:
        """Standard output of a command that went well."""
        assert self.returncode == 0, self
        return self.stdout

    @property
    def refusal(self) -> str:
        """The one line that a refused command says."""
        assert self.returncode == 2 and self.stdout == "", self
        assert self.stderr.startswith("nolens: ") and self.stderr.count("\n") == 1, self
        return self.stderr


class Command:
    """`nolens` with the packages of a folder, or none; a context that ends its process."""

    def __init__(self, packages: Path | None) -> None:
        paths = (packages and str(packages), os.environ.get("PYTHONPATH"))
        self._process = subprocess.Popen(
            [sys.executable, "-c", ANSWER],
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(filter(None, paths)),
                "COLUMNS": "100",
            },
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __call__(self, *arguments: object) -> Done:
        told, answers = self._process.stdin, self._process.stdout
        assert told is not None and answers is not None
        told.write(json.dumps([str(Path.cwd()), [str(each) for each in arguments]]) + "\n")
        told.flush()
        return Done(*json.loads(answers.readline()))

    def __enter__(self) -> "Command":
        return self

    def __exit__(self, *about: object) -> None:
        self._process.kill()
        self._process.__exit__(None, None, None)
