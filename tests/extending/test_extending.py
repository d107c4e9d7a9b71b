"""A package of one's own adds formats, cameras, masks and targets, without a change here."""

import os
import subprocess
import sys
from pathlib import Path

NOLENS = Path(sys.executable).with_name("nolens")
INSTALLED = Path(__file__).parent / "installed"


def nolens(*arguments: object) -> "subprocess.CompletedProcess[str]":
    """The installed command, with the example package installed beside it."""
    paths = os.pathsep.join(filter(None, (str(INSTALLED), os.environ.get("PYTHONPATH"))))
    return subprocess.run(
        [NOLENS, *map(str, arguments)],
        env={**os.environ, "PYTHONPATH": paths},
        capture_output=True,
        text=True,
        check=False,
    )
