"""The same bits from passes that were compiled just now and from those that the cache kept."""

import os
import subprocess
import sys
from pathlib import Path

# With its sums, an update has all that it has without them, which is compiled for itself.
PASSES = """
import hashlib
import torch
from nolens.kernels import admm_numba
from update_cases import BASE, MU, arrays, draw, normal_equation, replace, update

size = (180, 240)
for isotropic in (False, True):
    case = replace(BASE, size=size, sensor=(40, 60, 90, 100), support=(0, 0, *size),
                   isotropic=isotropic, relaxation=1.8)
    pair, state = draw(case)
    pair, sums = update(admm_numba, case, pair, state)
    for each in (torch.view_as_real(pair), *arrays(state)):
        print(hashlib.sha256(each.numpy().tobytes()).hexdigest(), sums)
spectrum, transfer, _ = normal_equation(size, MU)
admm_numba.solve_normal_equation_(spectrum, transfer, torch.tensor(MU))
print(hashlib.sha256(torch.view_as_real(spectrum).numpy().tobytes()).hexdigest())
"""


def test_same_bits(tmp_path: Path) -> None:
    told = []
    for _ in range(2):
        done = subprocess.run(
            [sys.executable, "-c", PASSES], capture_output=True, text=True, check=True,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}, cwd=Path(__file__).parent,
        )  # fmt: skip
        told.append(done.stdout)
    assert any(tmp_path.rglob("*.nbc"))
    assert told[0] == told[1]
