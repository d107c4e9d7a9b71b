"""What one pass of an ADMM iteration takes, by size: the figures of `docs/decisions/0001`.

`.venv/bin/python bench/passes.py` prints nanoseconds of processor time per cell, on one thread, the
least of some runs: what the code does, however busy the machine is otherwise.
"""

import time
from collections.abc import Callable

import torch
from torch import Tensor

from nolens.kernels import (
    SplitState,
    fft2_,
    ifft2_,
    in_large_pages,
    solve_normal_equation_,
    update_splits_,
)

SIZES = ((3040, 4056), (3072, 4096), (3080, 4116), (3072, 4116))
SENSOR = (1520, 2028)
MU = (0.02, 2.0, 1.0)
RUNS = 5


def state(period: tuple[int, int]) -> SplitState:
    """A full-domain problem of the paper's size."""
    top, left = ((p - n) // 2 for p, n in zip(period, SENSOR, strict=True))
    return SplitState(
        data=torch.rand(SENSOR),
        valid=torch.ones(SENSOR, dtype=torch.uint8),
        sensor=(top, left, *SENSOR),
        region=(0, 0, *period),
        tv=1e-4,
        isotropic=False,
        l1=0.0,
        measured=in_large_pages(torch.rand(period)),
        rows=in_large_pages(torch.rand(period)),
        columns=in_large_pages(torch.rand(period)),
        scene=in_large_pages(torch.rand(period)),
    )


def least(run: Callable[[], object]) -> float:
    """Seconds of processor time of the quickest run."""
    best = float("inf")
    for _ in range(RUNS):
        start = time.process_time()
        run()
        best = min(best, time.process_time() - start)
    return best


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    print("| period | transform | inverse | solve | update |")
    print("|---|---|---|---|---|")
    for period in SIZES:
        splits = state(period)
        transfer = torch.fft.rfft2(torch.rand(period))
        pair: Tensor = in_large_pages(torch.complex(torch.rand(period), torch.rand(period)))
        runs: tuple[Callable[[], object], ...] = (
            lambda pair=pair: fft2_(pair),
            lambda pair=pair: ifft2_(pair),
            lambda pair=pair, h=transfer: solve_normal_equation_(pair, h, MU),
            lambda pair=pair, splits=splits: update_splits_(pair, splits, MU, MU, 1.8),
        )
        cells = period[0] * period[1]
        figures = " | ".join(f"{least(run) / cells * 1e9:.1f}" for run in runs)
        print(f"| {period[0]}×{period[1]} | {figures} |")


if __name__ == "__main__":
    main()
