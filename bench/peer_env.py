"""The peer's environment, `.bench-venv`: made when missing or out of date. Standard library."""

from __future__ import annotations

import hashlib
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

PEER = "lensless==1.0.8"
# The peer says Python < 3.12; the versions of numpy and scipy that it is run with leave 3.11.
NEEDED = (3, 11)
REQUIREMENTS = Path(__file__).with_name("peer-requirements.txt")


def ensure(folder: Path) -> Path:
    """The environment's Python, after making or remaking the environment where that is needed."""
    python = folder / "bin" / "python"
    stamp = folder / ".installed"
    wanted = fingerprint()
    if python.exists() and stamp.exists() and stamp.read_text() == wanted:
        return python
    print(f"making {folder} with {PEER} (some minutes, once)", file=sys.stderr)
    run([find_python(), "-m", "venv", "--clear", folder])
    pip: list[str | Path] = [python, "-m", "pip", "install", "-qq", "--disable-pip-version-check"]
    run([*pip, "-r", REQUIREMENTS])
    # --no-deps: what it asks for beyond peer-requirements.txt is never imported by its ADMM.
    run([*pip, "--no-deps", PEER])
    run([python, "-c", "import lensless; lensless.ADMM"])
    stamp.write_text(wanted)
    return python


def fingerprint() -> str:
    """What the environment was made from."""
    return hashlib.sha256(PEER.encode() + REQUIREMENTS.read_bytes()).hexdigest()


def find_python() -> str:
    """A Python that the peer runs on: this one, or a `python3.11` on the path."""
    if sys.version_info[:2] == NEEDED:
        return sys.executable
    found = shutil.which("python{}.{}".format(*NEEDED))
    if found:
        return found
    raise SystemExit(
        f"make bench: the peer ({PEER}) needs Python 3.11 (3.12 and newer are too new for it).\n"
        f"This is {sys.version.split()[0]}, and there is no python3.11 on the PATH.\nInstall one "
        "and run `make bench` again: it finds python3.11 by itself.\n"
        "Or name it: make bench PYTHON=/path/to/python3.11"
    )


def run(command: Sequence[str | Path]) -> None:
    words = [str(word) for word in command]
    if subprocess.run(words, stdout=sys.stderr).returncode:
        raise SystemExit(
            f"make bench: could not make the peer's environment; this failed: {' '.join(words)}"
        )
