"""Triton's passes: as it interprets them on the CPU, on CUDA, and compiled for GPUs not here."""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
import torch

from nolens.kernels import admm

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("triton") is None,
    reason="Triton is not installed (its wheel is 290 MB; torch brings it along for CUDA)",
)
HERE = Path(__file__).parent


def _passes(arguments: list[str], environment: dict[str, str]) -> None:
    done = subprocess.run(
        [sys.executable, *arguments], cwd=HERE, capture_output=True, text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1", **environment},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr


def test_interpreted() -> None:
    _passes(["-m", "pytest", "-p", "no:xdist", "triton_cases.py"], {"TRITON_INTERPRET": "1"})


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device here")
def test_on_cuda() -> None:
    _passes(["-m", "pytest", "-p", "no:xdist", "triton_cases.py"], {"TRITON_INTERPRET": "0"})


def test_kernels_compile(tmp_path: Path) -> None:
    """The interpreter takes much that the compiler does not; this needs no GPU."""
    _passes(["triton_compile.py"], {"TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(tmp_path)})


def test_triton_that_cannot_run_is_passed_over() -> None:
    with pytest.warns(UserWarning, match="Triton does not run here"):
        assert not admm._triton_runs(torch.device("cpu"))
