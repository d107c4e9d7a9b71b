"""What one pass of an ADMM iteration takes, by size: the figures of `docs/decisions/0001`.

`.venv/bin/python bench/passes.py` prints nanoseconds of processor time per cell, on one thread, the
least of some runs: what the code does, however busy the machine is otherwise.

`bench/passes.py --share HEIGHT WIDTH` prints, as JSON, what the passes of an iteration take for a
sensor of that size and a PSF of the same: seconds on all threads, medians of runs in turn. The
update gathers its sums at every look alone, so the mean of the iterations between two is taken.
"""

import json
import statistics
import sys
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
from nolens.operators import Geometry
from nolens.solvers.admm_state import CHECK_EVERY

SIZES = ((3040, 4056), (3072, 4096), (3080, 4116), (3072, 4116))
SENSOR = (1520, 2028)
MU = (0.02, 2.0, 1.0)
RUNS = 5
TURNS = 11


def state(period: tuple[int, int], sensor: tuple[int, int] = SENSOR) -> SplitState:
    """A full-domain problem, of the paper's size where nothing else is said."""
    top, left = ((p - n) // 2 for p, n in zip(period, sensor, strict=True))
    return SplitState(
        data=torch.rand(sensor),
        valid=torch.ones(sensor, dtype=torch.uint8),
        sensor=(top, left, *sensor),
        support=(0, 0, *period),
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


def passes(period: tuple[int, int], splits: SplitState) -> dict[str, Callable[[], object]]:
    """The passes of an iteration over one channel, by name; it has one of the two updates."""
    transfer = torch.fft.rfft2(torch.rand(period))
    pair: Tensor = in_large_pages(torch.complex(torch.rand(period), torch.rand(period)))
    return {
        "transform": lambda: fft2_(pair),
        "inverse": lambda: ifft2_(pair),
        "solve": lambda: solve_normal_equation_(pair, transfer, MU),
        "update": lambda: update_splits_(pair, splits, MU, MU, 1.8, counted=False),
        "update with sums": lambda: update_splits_(pair, splits, MU, MU, 1.8, counted=True),
    }


def share(sensor: tuple[int, int]) -> dict[str, object]:
    """Median seconds of every pass, and the share that is not transforms."""
    period = Geometry.build(sensor, sensor, None).padded
    runs = passes(period, state(period, sensor))
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(TURNS):
        for name, run in runs.items():
            start = time.perf_counter()
            run()
            seconds[name].append(time.perf_counter() - start)
    median = {
        name: statistics.median(each[1:]) for name, each in seconds.items()
    }  # first: compiles
    summed = median.pop("update with sums")
    median["update"] += (summed - median["update"]) / CHECK_EVERY
    others = median["solve"] + median["update"]
    return {
        "period": period,
        "threads": torch.get_num_threads(),
        "turns": TURNS - 1,
        "look": CHECK_EVERY,
        "median_s": median,
        "share": others / sum(median.values()),
    }


def table() -> None:
    """Print the table of the decision."""
    torch.set_num_threads(1)
    print("| period | transform | inverse | solve | update | update with sums |")
    print("|---|---|---|---|---|---|")
    for period in SIZES:
        cells = period[0] * period[1]
        runs = passes(period, state(period)).values()
        figures = " | ".join(f"{least(run) / cells * 1e9:.1f}" for run in runs)
        print(f"| {period[0]}×{period[1]} | {figures} |")


if __name__ == "__main__":
    if sys.argv[1:2] == ["--share"]:
        print(json.dumps(share((int(sys.argv[2]), int(sys.argv[3])))))
    else:
        table()
