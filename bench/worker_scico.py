"""scico's side of the benchmark: its ADMM (0.0.7, BSD-3-Clause), run by `.bench-venv/scico`.

How it is posed. f = 0; the misfit on the sensor's cells, the l1 norm of the periodic differences
and non-negativity are its functionals g behind a `CircularConvolve`, a `FiniteDifference` and the
identity. With PSF and measurement of unit l2 norm, that is the problem of objective.py. The crop
is a `Diagonal` of ones and zeros on the whole period, for which scico's proximal map is a closed
form, where for its `Crop` it runs conjugate gradients. `CircularConvolveSolver` then solves the
image update exactly. The period is found as nolens finds its own: jax's transforms are faster
there than where rows are multiples of 256, too.

Penalties. scico ships none for this problem. It has (0.1, 10, 10), the constants that did best on
the hand among those that `docs/decisions/0002` tried, and its own default relaxation of 1 (none).

How it is timed. By `step`, without the statistics that `solve` gathers. jax compiles anew for
every problem: a step before the clock, whose state is put back, compiles the iteration; what
posing compiles remains in the set-up.
"""

from __future__ import annotations

import gc
import os
from importlib.metadata import version
from platform import python_version
from time import perf_counter
from typing import Any

import jax
import numpy as np
import numpy.typing as npt
import scico.numpy as snp
from scico.functional import L1Norm, NonNegativeIndicator
from scico.linop import CircularConvolve, Diagonal, FiniteDifference, Identity
from scico.loss import SquaredL2Loss
from scico.optimize.admm import ADMM, CircularConvolveSolver
from scipy.fft import next_fast_len

from curve import Trace, judges, looks
from objective import window
from protocol import peak_mib, serve

PENALTIES = (0.1, 10.0, 10.0)
Stack = npt.NDArray[np.float32]


class Side:
    """The solver and the problem that it holds."""

    def __init__(self) -> None:
        self.solver: Any = None
        self.baseline = peak_mib()

    def about(self) -> dict[str, Any]:
        """Versions and threads."""
        versions = {name: version(name) for name in ("scico", "jax", "jaxlib", "numpy", "scipy")}
        threads = len(os.sched_getaffinity(0))  # jax takes all it may run on
        return {"python": python_version(), **versions, "threads": threads}

    def load(self, psf: str, data: str) -> dict[str, Any]:
        """Pose one problem, and compile its iteration."""
        frames = np.load(psf), np.load(data)
        start = perf_counter()
        self.solver = posed(*frames, tau=1e-4)
        seconds = perf_counter() - start
        compiled(self.solver)
        return {"setup_s": seconds}

    def iterate(self, iterations: int) -> dict[str, Any]:
        """Seconds per iteration, going on from the present state."""
        start = perf_counter()
        for _ in range(iterations):
            self.solver.step()
        finished(self.solver)
        return {"s_per_iteration": (perf_counter() - start) / iterations}

    def trace(self, tau: float, iterations: int, count: int | None, **files: str) -> dict[str, Any]:
        """Objective against seconds, set-up included."""
        frames = np.load(files["psf"]), np.load(files["data"])
        trace = Trace(*judges(files, tau), looks(iterations, count))
        self.solver = posed(*frames, tau=tau)
        with trace.aside():
            compiled(self.solver)
        for iteration in range(1, iterations + 1):
            self.solver.step()
            finished(self.solver)
            trace.watch(iteration, lambda: np.asarray(self.solver.x))
        return {"rows": trace.rows}

    def peak(self) -> dict[str, Any]:
        """The most memory held so far, and what the imports took."""
        return {"peak_mib": peak_mib(), "baseline_mib": self.baseline}

    def drop(self) -> dict[str, Any]:
        """Let go of the problem and its memory."""
        self.solver = None
        gc.collect()  # the solver's parts hold one another
        return {}


def posed(psf: Stack, data: Stack, tau: float) -> ADMM:
    """The problem and a cold start, ready when this returns."""
    height, width = data.shape[-2:]
    period = (fast_length(2 * height - 1, rows=False), fast_length(2 * width - 1, rows=True))
    shape = (len(data), *period)
    sensor = (..., *window(period, (height, width)))
    measured, inside = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    measured[sensor], inside[sensor] = data, 1
    solver = ADMM(
        f=None,
        g_list=[
            SquaredL2Loss(snp.array(measured), A=Diagonal(snp.array(inside)), scale=0.5),
            tau * L1Norm(),
            NonNegativeIndicator(),
        ],
        C_list=[
            CircularConvolve(
                snp.array(psf), shape, ndims=2, h_center=[psf.shape[-2] // 2, psf.shape[-1] // 2]
            ),
            FiniteDifference(shape, axes=(1, 2), circular=True),
            Identity(shape),
        ],
        rho_list=list(PENALTIES),
        subproblem_solver=CircularConvolveSolver(),
    )
    finished(solver)
    return solver


def fast_length(at_least: int, *, rows: bool) -> int:
    """The next even and fast length; for rows none that is a multiple of 256."""
    length = int(next_fast_len(at_least))
    while length % 2 or (rows and length % 256 == 0):
        length = int(next_fast_len(length + 1))
    return length


def compiled(solver: ADMM) -> None:
    """Compile what a step calls, by a step that is then taken back."""
    before = solver.x, solver.z_list.copy(), solver.z_list_old.copy(), solver.u_list.copy()
    solver.step()
    finished(solver)
    solver.x, solver.z_list, solver.z_list_old, solver.u_list = before


def finished(solver: ADMM) -> None:
    """Wait for what jax still computes."""
    jax.block_until_ready((solver.x, solver.z_list, solver.u_list))


if __name__ == "__main__":
    serve(Side())
