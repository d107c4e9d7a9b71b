"""The peer's side of the benchmark: ADMM of lensless 1.0.8, run by `.bench-venv/bin/python`.

lensless (LenslessPiCam) is AGPL-licensed. None of its code is in this repository: it is installed
from PyPI into an environment of its own, and only this process, which nolens neither imports nor
ships, calls it, through its public interface alone.

How it is posed. Its ADMM does not scale what it is given (only its file loaders do), transforms
without normalisation, and minimises 1/2 ||b - C M v||^2 + tau ||Psi v||_1 with v >= 0 over a
periodic domain of the next fast length from 2 n - 1. So with PSF and measurement of unit l2 norm
it solves the problem of objective.py as it stands; where twice the (even) size is a fast length,
on a domain of twice the size. Penalties, tau, dtype (float32), transforms and threads are its
defaults.

How it is timed. `apply` runs n iterations and then crops the picture. Two calls with different n,
both going on from the present state (`reset=False`), differ by iterations alone.

How its iterate is seen. The whole-domain iterate is handed to the `psi` that a user may give, once
after every image update. For the trace (never for the timing) psi is the peer's own finite
difference with a look at its argument before it.
"""

from __future__ import annotations

import sys
from functools import partial
from importlib.metadata import version
from platform import python_version
from time import perf_counter
from typing import Any

import lensless
import numpy as np
import torch
from lensless.recon import admm as peer

from curve import Trace, judges, looks
from protocol import peak_mib, serve

Stack = Any  # numpy array or torch tensor, as the backend has it


class Side:
    """One backend of the peer and the problem that it holds."""

    def __init__(self, backend: str) -> None:
        self.torch = backend == "torch"
        self.solver: Any = None
        self.baseline = peak_mib()

    def about(self) -> dict[str, Any]:
        """Versions and threads."""
        names = ("lensless", "numpy", "scipy", "torch")
        versions = {name: version(name) for name in names}
        threads = torch.get_num_threads() if self.torch else 1
        return {"python": python_version(), **versions, "threads": threads}

    def load(self, psf: str, data: str) -> dict[str, Any]:
        """Set up the solver for one problem."""
        frames = self._read(psf)[None], self._read(data)
        start = perf_counter()
        self.solver = lensless.ADMM(frames[0])
        self.solver.set_data(frames[1])
        return {"setup_s": perf_counter() - start}

    def iterate(self, iterations: int) -> dict[str, Any]:
        """Seconds per iteration, by the difference of two runs."""
        short = self._apply(1)
        return {"s_per_iteration": (self._apply(1 + iterations) - short) / iterations}

    def trace(self, tau: float, iterations: int, count: int | None, **files: str) -> dict[str, Any]:
        """Objective against seconds, set-up included."""
        frames = self._read(files["psf"])[None], self._read(files["data"])
        trace = Trace(*judges(files, tau), looks(iterations, count))
        observed = Observed(trace)
        gram = partial(peer.finite_diff_gram, is_torch=self.torch)
        self.solver = lensless.ADMM(
            frames[0], tau=tau, psi=observed, psi_adj=peer.finite_diff_adj, psi_gram=gram
        )
        self.solver.set_data(frames[1])
        observed.armed = True
        self.solver.apply(n_iter=iterations, disp_iter=None, plot=False, reset=False)
        return {"rows": trace.rows}

    def peak(self) -> dict[str, Any]:
        """The most memory held so far, and what the imports took."""
        return {"peak_mib": peak_mib(), "baseline_mib": self.baseline}

    def drop(self) -> dict[str, Any]:
        """Let go of the problem and its memory."""
        self.solver = None
        return {}

    def _read(self, path: str) -> Stack:
        """A file of (channels, height, width) in the peer's (height, width, channels) order."""
        array = np.ascontiguousarray(np.moveaxis(np.load(path), 0, -1))
        return torch.from_numpy(array) if self.torch else array

    def _apply(self, iterations: int) -> float:
        start = perf_counter()
        self.solver.apply(n_iter=iterations, disp_iter=None, plot=False, reset=False)
        return perf_counter() - start


class Observed:
    """The peer's finite differences, which show a trace the iterate they are given."""

    def __init__(self, trace: Trace) -> None:
        self.armed = False  # while the solver is set up it asks for the differences of zero
        self._trace = trace
        self._iteration = 0

    def __call__(self, iterate: Stack) -> Stack:
        """Differences of the iterate, shown first once armed."""
        if self.armed:
            self._iteration += 1
            self._trace.watch(
                self._iteration, lambda: np.moveaxis(np.asarray(iterate)[0, 0], -1, 0)
            )
        return peer.finite_diff(iterate)


if __name__ == "__main__":
    serve(Side(sys.argv[1]))
