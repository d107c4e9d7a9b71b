"""The solver on a CUDA device: seconds, and how near it comes to what memory allows.

`.venv/bin/python bench/on_cuda.py HEIGHT WIDTH ITERATIONS` prints one JSON object; null where there
is no such device.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Callable
from typing import Any

import torch

from nolens.solvers import Problem, admm
from photo import photo

CHANNELS = 3
FRAMES = 20
COPIED_BYTES = 2**30
COPIES = 20
COMPLEX, REAL = 8, 4


def drawn(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """PSF and measurement of random numbers: what they take does not depend on them."""
    generator = torch.Generator().manual_seed(0)
    psf, data = (torch.rand((CHANNELS, height, width), generator=generator) for _ in range(2))
    return psf.cuda(), data


def bytes_per_iteration(problem: Problem) -> int:
    """The least that an iteration moves, all channels, if every pass moves each array once.

    Two transforms read and write the complex pair twice, along rows and along columns. The solve
    reads and writes it and reads the PSF's half spectrum. The update reads and writes it and the
    four real arrays of the splits, and reads the measurement and which of its pixels are valid.
    """
    cells = math.prod(problem.forward.geometry.padded)
    transforms = 2 * 2 * 2 * COMPLEX * cells
    solve = 2 * COMPLEX * cells + problem.transfer(0).nbytes
    update = 2 * COMPLEX * cells + 2 * 4 * REAL * cells
    sensor = problem.data[0].nbytes + problem.valid[0].numel()
    return problem.channels * (transforms + solve + update + sensor)


def seconds(run: Callable[[], object]) -> float:
    """Until the device is done."""
    torch.cuda.synchronize()
    start = time.perf_counter()
    run()
    torch.cuda.synchronize()
    return time.perf_counter() - start


def bandwidth() -> float:
    """Bytes per second that a copy within the device reads and writes."""
    source = torch.zeros(COPIED_BYTES, dtype=torch.uint8, device="cuda")
    target = torch.empty_like(source)

    def copies() -> None:
        for _ in range(COPIES):
            target.copy_(source)

    copies()
    return 2 * COPIED_BYTES * COPIES / seconds(copies)


def photos(psf: torch.Tensor, frame: torch.Tensor, count: int) -> None:
    """Reconstruct frames, each brought to the device, posed and solved anew."""
    for _ in range(count):
        photo(Problem.build(psf, frame.cuda())).scene.cpu()


def measured(height: int, width: int, iterations: int) -> dict[str, Any]:
    """All of it, each after a first run that fills caches."""
    full, half = drawn(height, width), drawn(height // 2, width // 2)
    problem = Problem.build(full[0], full[1].cuda())
    photos(*full, 1)
    took = seconds(lambda: admm(problem, iterations=iterations, tolerance=0.0))
    photo_s = seconds(lambda: photos(*full, 1))
    photos(*half, 1)
    moved, rate = bytes_per_iteration(problem), bandwidth()
    return {
        "device": torch.cuda.get_device_name(),
        "size": [height, width, CHANNELS],
        "period": problem.forward.geometry.padded,
        "iterations": iterations,
        "seconds": took,
        "bytes_per_iteration": moved,
        "bytes_per_s": rate,
        "share_of_floor": moved / rate / (took / iterations),
        "photo_s": photo_s,
        "stream_size": [height // 2, width // 2, CHANNELS],
        "frames_per_s": FRAMES / seconds(lambda: photos(*half, FRAMES)),
    }


def main(*numbers: str) -> None:
    found = measured(*(int(number) for number in numbers)) if torch.cuda.is_available() else None
    print(json.dumps(found))


if __name__ == "__main__":
    main(*sys.argv[1:])
