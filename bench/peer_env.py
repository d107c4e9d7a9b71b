"""The peers' environments in `.bench-venv`: made when missing or out of date. Standard library."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

# lensless says Python < 3.12; the versions of numpy and scipy that it is run with leave 3.11.
NEEDED = (3, 11)
HERE = Path(__file__).parent


@dataclass(frozen=True)
class Peer:
    """A package from PyPI, what it needs, and what shows that it can be used.

    Parameters
    ----------
    package
        Name and version.
    requirements
        File beside this one.
    bare
        Install the package itself without what it asks for.
    check
        Python that must run.
    folder
        Of its environment, within `.bench-venv`.
    """

    package: str
    requirements: str
    bare: bool
    check: str
    folder: str

    def ensure(self, root: Path) -> Path:
        """The environment's Python, after making or remaking the environment where needed."""
        folder = root / self.folder
        python = folder / "bin" / "python"
        stamp = folder / ".installed"
        wanted = self.fingerprint()
        if python.exists() and stamp.exists() and stamp.read_text() == wanted:
            return python
        print(f"making {folder} with {self.package} (some minutes, once)", file=sys.stderr)
        self.run([self.find_python(), "-m", "venv", "--clear", folder])
        quiet = ["install", "-qq", "--disable-pip-version-check"]
        pip: list[str | Path] = [python, "-m", "pip", *quiet]
        self.run([*pip, "-r", HERE / self.requirements])
        if self.bare:
            self.run([*pip, "--no-deps", self.package])
        self.run([python, "-c", self.check])
        stamp.write_text(wanted)
        return python

    def fingerprint(self) -> str:
        """What the environment was made from."""
        requirements = (HERE / self.requirements).read_bytes()
        return hashlib.sha256(self.package.encode() + requirements).hexdigest()

    def find_python(self) -> str:
        """A Python that the peers run on: this one, or a `python3.11` on the path."""
        if sys.version_info[:2] == NEEDED:
            return sys.executable
        found = shutil.which("python{}.{}".format(*NEEDED))
        if found:
            return found
        raise SystemExit(
            f"make bench: the peer ({self.package}) is run with Python 3.11, the newest that all "
            f"peers have.\nThis is {sys.version.split()[0]}, and there is no python3.11 on the "
            "PATH.\nInstall one and run `make bench` again: it finds python3.11 by itself.\n"
            "Or name it: make bench PYTHON=/path/to/python3.11"
        )

    def run(self, command: Sequence[str | Path]) -> None:
        """Run a command, or end with what failed."""
        words = [str(word) for word in command]
        if subprocess.run(words, stdout=sys.stderr).returncode:
            raise SystemExit(
                f"make bench: could not make the environment of {self.package}; this failed: "
                f"{' '.join(words)}"
            )


# Bare: what lensless asks for beyond its requirements file is never imported by its ADMM.
LENSLESS_PEER = Peer(
    package="lensless==1.0.8",
    requirements="peer-requirements.txt",
    bare=True,
    check="import lensless; lensless.ADMM",
    folder=".",
)
# Inside the other one, so that making that one anew clears this one too: make it second.
SCICO_PEER = Peer(
    package="scico==0.0.7",
    requirements="peer-requirements-scico.txt",
    bare=False,
    check="from scico.optimize.admm import ADMM",
    folder="scico",
)
