"""A sequence of measurements, each reconstructed from where the one before it ended."""

import time
from dataclasses import dataclass

from torch import Tensor

from nolens.errors import OptionError
from nolens.solvers.admm import admm
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.penalties import LOOK, Penalties
from nolens.solvers.problem import Problem
from nolens.solvers.quality import STOPS, Quality
from nolens.solvers.result import Progress

WARM: Penalties = (0.1, 3.0, 1.0)
"""Penalties that a frame starts from: small enough to follow what moves (decision 7)."""
_FOLLOWING = 8
"""Iterations of a frame after the first, where nothing moves faster than some cells a frame."""


@dataclass(frozen=True)
class Frame:
    """One picture of a stream.

    Parameters
    ----------
    scene
        `(channels, height, width)` in units of the measurement over the PSF.
    iterations
        That it took.
    seconds
        That it took.
    """

    scene: Tensor
    iterations: int
    seconds: float


class Stream:
    """Reconstructs frame after frame through one PSF (ADMM, warm-started).

    The first frame is solved as a photo is. Each frame after it starts from the splits and
    multipliers of the one before and gets a few iterations, so that an unmoving scene goes on to
    converge and a moving one is followed. Memory is that of one reconstruction, however long the
    stream is.

    Parameters
    ----------
    problem
        Of the first measurement; all others have its sizes.
    iterations
        Of every frame after the first, ≥ 1.
    latency_s
        Seconds that a frame may take, counted from the call: it ends with the look before they
        are over, four iterations at the least. None for no bound.

    Raises
    ------
    OptionError
        If `iterations` or `latency_s` is not above 0.
    """

    def __init__(
        self, problem: Problem, *, iterations: int = _FOLLOWING, latency_s: float | None = None
    ) -> None:
        if iterations < 1:
            raise OptionError(f"iterations is {iterations}; a frame needs 1 or more")
        if latency_s is not None and not latency_s > 0:
            raise OptionError(f"latency_s is {latency_s:g}; it must be above 0")
        self._problem = problem
        self._state: AdmmState | None = None
        self._iterations = iterations
        self._latency_s = latency_s

    def solve(self, data: Tensor, valid: Tensor | None = None) -> Frame:
        """Reconstruct the next frame.

        Parameters
        ----------
        data, valid
            As `Problem.pose` takes them.

        Raises
        ------
        DataError
            If the frame has other sizes than the first, or cannot be solved for. The stream goes
            on with the next one as if this had not been.
        """
        begun = time.perf_counter()
        problem = self._problem.measuring(data, valid)
        first = self._state is None
        if self._state is None:
            self._state = AdmmState.cold(problem)
        else:
            self._state.renew(problem, WARM)
        stop = STOPS[Quality.PHOTO]
        result = admm(
            problem,
            iterations=stop.iterations if first else self._iterations,
            tolerance=0.0,
            scene_tolerance=stop.scene_tolerance,
            state=self._state,
            callback=_Deadline(begun, self._latency_s),
        )
        return Frame(result.scene, result.iterations, time.perf_counter() - begun)


class _Deadline:
    """Stops a run with the last look that fits into its time."""

    def __init__(self, begun: float, seconds: float | None) -> None:
        self._end = None if seconds is None else begun + seconds
        self._last = begun

    def __call__(self, progress: Progress) -> bool:
        now = time.perf_counter()
        # The last stretch also has to undo the scaling, so twice the time of one is kept.
        ahead = now + 2 * (now - self._last) if progress.iteration > LOOK else now
        self._last = now
        return self._end is not None and ahead > self._end
