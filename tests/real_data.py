"""Where the measurements lie that are too large for the repository."""

import os
from pathlib import Path

import pytest

ROOT = Path(os.environ.get("NOLENS_DATA") or Path(__file__).parents[2] / "shared" / "data")


def real_data(name: str) -> Path:
    """File or folder of the real data; skips the test where it is absent.

    The folder is `../shared/data` beside the repository, or what NOLENS_DATA names.
    """
    path = ROOT / name
    if not path.exists():
        pytest.skip(f"no {path}: the real data are not here (NOLENS_DATA names their folder)")
    return path
