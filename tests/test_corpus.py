"""Every file that ever broke something, through what it broke."""

import os
import subprocess
import sys
from pathlib import Path

_HERE = Path(__file__).parent


def test_corpus(tmp_path: Path) -> None:
    """Exit code 0, 2, 3 or 130, a message, and no more time or memory than is allowed."""
    done = subprocess.run(
        [sys.executable, _HERE / "fuzzing" / "run.py", "--replay", _HERE / "corpus"],
        cwd=tmp_path,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=240,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
