"""The same bits from passes that were compiled just now and from those that the cache kept."""

import os
import subprocess
import sys
from pathlib import Path

SOLVE = """
import hashlib
import torch
from nolens.operators import PixelRectangle
from nolens.solvers import Problem, admm

generator = torch.Generator().manual_seed(0)
psf, data = torch.rand((2, 1, 180, 240), generator=generator)
problem = Problem.build(psf**8, data, support=PixelRectangle.centred(90, 100, (180, 240)), tau=1e-4)
scene = admm(problem, iterations=40, tolerance=0.0).scene
print(hashlib.sha256(scene.numpy().tobytes()).hexdigest())
"""


def test_same_bits(tmp_path: Path) -> None:
    told = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", SOLVE], capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "OMP_NUM_THREADS": "1"},
        )  # fmt: skip
        told.append(done.stdout)
    assert any(tmp_path.rglob("*.nbc"))
    assert told[0] == told[1]
