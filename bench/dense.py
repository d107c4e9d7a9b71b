"""A photograph that fills the support: picture quality, and what it takes.

`.venv/bin/python bench/dense.py HEIGHT WIDTH SIDE` prints one JSON object. The PSF is wider than
the sensor: known on all cells whose light reaches it from there.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any

from skimage import data as photographs

from nolens.evaluate import psnr, scale_fit
from nolens.solvers import Problem, Result, admm
from photo import photo, quick
from photographed import GREEN_ALONE, Shot, linear_light, mask_psf, shot

TAUS = (3e-6, 1e-5, 3e-5)
CONVERGED = 600
RUNS = 3


def seen(sensor: tuple[int, int], side: int) -> Shot:
    """The measurement."""
    psf = mask_psf((sensor[0] + side, sensor[1] + side), GREEN_ALONE)
    return shot(linear_light(photographs.astronaut(), side, channels=1), psf, sensor)


def posed(given: Shot, tau: float) -> Problem:
    return Problem.build(given.psf, given.data, support=given.support, tau=tau)


def converged(given: Shot, tau: float) -> dict[str, Any]:
    """Quality at the end of many iterations, without a stop before."""
    result = admm(posed(given, tau), iterations=CONVERGED, tolerance=0.0)
    return {"tau": tau, "psnr_db": quality(given, result.scene), "objective": result.objective}


def timed(given: Shot, tau: float, solve: Callable[[Problem], Result]) -> dict[str, Any]:
    """Seconds of posing and solving, and what comes of it."""
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        result = solve(posed(given, tau))
        seconds.append(time.perf_counter() - start)
    return {
        "tau": tau,
        "seconds": seconds,
        "median_s": statistics.median(seconds),
        "iterations": result.iterations,
        "psnr_db": quality(given, result.scene),
    }


def quality(given: Shot, scene: Any) -> float:
    return psnr(scale_fit(scene, given.truth), given.truth, 1.0)


def main(height: int, width: int, side: int) -> None:
    given = seen((height, width), side)
    for solve in (photo, quick):
        solve(posed(seen((96, 128), 64), TAUS[0]))  # compiles
    runs = [converged(given, tau) for tau in TAUS]
    best = max(runs, key=lambda run: run["psnr_db"])
    found = {
        "sensor": [height, width],
        "side": side,
        "period": posed(given, TAUS[0]).forward.geometry.padded,
        "iterations": CONVERGED,
        "converged": runs,
        "best": best,
        "photo": timed(given, best["tau"], photo),
        "quick": timed(given, best["tau"], quick),
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main(*(int(number) for number in sys.argv[1:]))
