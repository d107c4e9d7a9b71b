"""nolens's side of the benchmark, run by `.venv/bin/python`.

How it is timed. `admm` is called from a cold start as anybody calls it, with its own choice of
penalties and everything that it checks on the way; its callback, which it calls every few
iterations and after the last, reads the clock. Seconds per iteration are those between its first
and its last call, over the iterations between them; what comes before the first call, less its
iterations, counts as set-up, and so does posing the problem.
"""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version
from platform import python_version
from time import perf_counter
from typing import Any

import numpy as np
import torch

from curve import Trace, judges, looks
from nolens.solvers import Problem, admm
from protocol import peak_mib, serve

LEAST = 9  # iterations; the callback is called at least twice in so many
AGREE = 0.1  # share; v and its splits differ by less, a misread layout by far more


class Side:
    """The problem that nolens holds."""

    def __init__(self) -> None:
        self.problem: Any = None
        self.baseline = peak_mib()

    def about(self) -> dict[str, Any]:
        """Versions and threads."""
        versions = {}
        for name in ("nolens", "numpy", "scipy", "torch", "numba", "ducc0"):
            try:
                versions[name] = version(name)
            except PackageNotFoundError:
                versions[name] = "not installed"
        return {"python": python_version(), **versions, "threads": torch.get_num_threads()}

    def load(self, psf: str, data: str) -> dict[str, Any]:
        """Pose one problem."""
        frames = read(psf), read(data)
        start = perf_counter()
        self.problem = Problem.build(*frames, tau=1e-4)
        seconds = perf_counter() - start
        return {"setup_s": seconds, "period": self.problem.forward.geometry.padded}

    def iterate(self, iterations: int) -> dict[str, Any]:
        """Seconds per iteration after the first ones, and what `admm` did before that."""
        calls: list[tuple[int, float]] = []
        start = perf_counter()
        admm(
            self.problem,
            iterations=max(LEAST, 1 + iterations),
            tolerance=0.0,
            callback=lambda now: calls.append((now.iteration, perf_counter())),
        )
        (early, before), (late, after) = calls[0], calls[-1]
        each = (after - before) / (late - early)
        return {"s_per_iteration": each, "setup_s": max(0.0, before - start - early * each)}

    def trace(self, tau: float, iterations: int, count: int | None, **files: str) -> dict[str, Any]:
        """Objective against seconds, set-up included; both ways to compute it must agree."""
        frames = read(files["psf"]), read(files["data"])
        trace = Trace(*judges(files, tau), looks(iterations, count))
        problem = Problem.build(*frames, tau=tau)
        result = admm(
            problem,
            iterations=iterations,
            tolerance=0.0,
            callback=lambda now: trace.watch(now.iteration, lambda: np.asarray(now.scene())),
        )
        own, judged = float(result.objective), trace.rows[-1][2]
        if not abs(own - judged) <= AGREE * judged:
            raise ValueError(f"nolens's objective {own:.4e} is not objective.py's {judged:.4e}")
        return {"rows": trace.rows, "own_objective": own}

    def peak(self) -> dict[str, Any]:
        """The most memory held so far, and what the imports took."""
        return {"peak_mib": peak_mib(), "baseline_mib": self.baseline}

    def drop(self) -> dict[str, Any]:
        """Let go of the problem and its memory."""
        self.problem = None
        return {}


def read(path: str) -> torch.Tensor:
    return torch.from_numpy(np.load(path))


if __name__ == "__main__":
    serve(Side())
