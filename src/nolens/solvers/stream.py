"""A sequence of measurements, each reconstructed from where the one before it ended; live, too."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from threading import Condition, Thread
from types import TracebackType

import torch
from torch import Tensor

from nolens.errors import DivergenceError, NolensError, OptionError
from nolens.solvers.admm import AdmmRun, DataStepRun, admm, start_run
from nolens.solvers.admm_state import CHECK_EVERY, AdmmState, Penalties
from nolens.solvers.data_step import data_step_start
from nolens.solvers.inputs import Plane
from nolens.solvers.problem import Problem
from nolens.solvers.result import STOPS, Progress, Quality, has_converged
from nolens.solvers.wiener import circulant_wiener

_WARM: Penalties = (1.0, 3.0, 1.0)
"""Penalties that a frame starts from: small enough to follow what moves (decision 7)."""
_WARM_FEW: Penalties = (1.0, 10.0, 3.0)
"""The same for less than four iterations, which have no time to lose the noise in."""
_WARM_SPILLING: Penalties = (0.3, 3.0, 1.0)
"""The same where the sensor misses much of the light: what falls beside it is then the old one."""
_MOST_LIGHT = 0.75
"""Fraction of the light on the sensor from which on the first two are better."""
_CUT, _CUT_TIMES = 0.25, 2.0
"""A frame that the picture before it misses by more than this fraction, and by more than so many
times what it missed the frame before by, is of another scene: measured for decision 7."""
_WIENER_TAU = 0.5
_STOP = STOPS[Quality.PHOTO]
FOLLOWING = 8
"""Iterations of a frame after the first, where nothing moves faster than some pixels a frame."""


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
    frame
        Window (top, left, height, width) of the scene that `photograph` is (`Problem.frame`).
    """

    scene: Tensor = field(repr=False)
    iterations: int
    seconds: float
    frame: tuple[int, int, int, int]

    @property
    def photograph(self) -> Tensor:
        """The scene's support; without one, what lies in the sensor's frame."""
        top, left, height, width = self.frame
        return self.scene[..., top : top + height, left : left + width]


CHECK_WEIGHT_EVERY = 25
"""Frames after which the choice of the weight is checked."""
_WEIGHT_CHANGED = 2.0


def weight_to_follow(weight: float, chosen: float) -> float:
    """The weight to go on with: another choice only where it differs by more than a factor of 2.

    Choices scatter from frame to frame, and pictures would flicker with them.

    Parameters
    ----------
    weight
        So far.
    chosen
        By a later frame.
    """
    near = weight / _WEIGHT_CHANGED <= chosen <= weight * _WEIGHT_CHANGED
    return weight if near else chosen


class Stream:
    """Reconstructs frame after frame of one camera (ADMM, warm-started).

    The first frame is solved as a photo is. Each frame after it starts from the splits and
    multipliers of the one before and gets a few iterations, so that an unmoving scene goes on to
    converge and a moving one is followed. With PSFs over the field the measurement stays in the
    linear step, and colours are taken together, as in a photo. Where a frame shows another scene (a
    cut), the picture before it would take many frames to leave: it starts from the Wiener filter's
    instead. Memory is that of one reconstruction, however long the stream is.

    Parameters
    ----------
    problem
        Of the first measurement; all others have its sizes.
    iterations
        Of every frame after the first, ≥ 1.
    latency_s
        Seconds that a frame may take, counted from the call: it ends with the check before they
        are over, four iterations at the least. None for no bound.

    Raises
    ------
    OptionError
        If `iterations` or `latency_s` is not above 0.
    """

    def __init__(
        self, problem: Problem, *, iterations: int = FOLLOWING, latency_s: float | None = None
    ) -> None:
        check_frame_limits(iterations, latency_s)
        # Colours are taken together only where the measurement is in the linear step anyway.
        varied = problem.forward.field_points > 1
        self._problem = problem if varied else problem.by_channel
        self._run: AdmmRun | DataStepRun | None = None
        self._iterations = iterations
        self._latency_s = latency_s
        self._residual = float("inf")
        self.cuts = 0
        """Frames so far that were of another scene than the one before."""

    @property
    def weight(self) -> float:
        """Weight of the prior (`Problem.weight`)."""
        return self._problem.weight

    def weigh(self, weight: float) -> None:
        """Go on with another weight of the prior; the pictures follow in a few frames.

        Parameters
        ----------
        weight
            In the unit of `Problem.weight`, ≥ 0.
        """
        before, self._problem = self._problem.tau, self._problem.weighted(weight)
        if self._run is None or before == self._problem.tau:
            return
        if 0 in (before, self._problem.tau):
            self._run = None  # A weight of zero leaves out a split.
            return
        self._run.state.weigh(self._problem)
        if isinstance(self._run, AdmmRun):  # The other takes the weight with the measurement.
            self._run = start_run(self._problem, self._run.state)

    def solve(self, data: Plane, valid: Plane | None = None) -> Frame:
        """Reconstruct the next frame.

        Parameters
        ----------
        data, valid
            As `Problem.build` takes them.

        Raises
        ------
        DataError
            If the frame has other sizes than the first, or cannot be solved for. The stream goes
            on with the next one as if this had not been.
        """
        begun = time.perf_counter()
        problem = self._problem.measuring(data, valid)
        deadline = Deadline(begun, self._latency_s)
        try:
            if self._run is None:
                scene, iterations = self._first(problem, deadline)
            else:
                scene, iterations = self._next(self._run, problem, deadline)
        except DivergenceError:
            self._run = None  # The next frame starts anew.
            raise
        scene = problem.unscale(scene)
        return Frame(scene, iterations, time.perf_counter() - begun, problem.frame)

    def _first(self, problem: Problem, deadline: "Deadline") -> tuple[Tensor, int]:
        """Scene in normalised units and iterations of a frame that is solved as a photo is."""
        state = AdmmState.cold(problem)
        result = admm(
            problem,
            iterations=_STOP.iterations,
            tolerance=0.0,
            scene_tolerance=_STOP.scene_tolerance,
            state=state,
            callback=deadline,
        )
        self._run = start_run(problem, state)
        return result.scene / problem.scale, result.iterations

    def _next(
        self, run: AdmmRun | DataStepRun, problem: Problem, deadline: "Deadline"
    ) -> tuple[Tensor, int]:
        """The same for a frame that goes on from the one before, or from a cut."""
        before, self._residual = self._residual, run.state.residual(problem)
        penalties = self._warm(run)
        if is_cut(self._residual, before):
            self.cuts += 1
            run = self._run = _from_wiener(problem, penalties)
        else:
            run.measure(problem, penalties)
        state = run.state
        history: list[dict[str, float]] = []
        while state.iteration < self._iterations:
            progress = run.to_check(self._iterations)
            history.append(progress.row())
            if deadline(progress) or has_converged(history, _STOP.scene_tolerance):
                break
        scene = state.scene()
        if state.fills_view:
            scene, _ = problem.gain_corrected(scene)
        return scene, state.iteration

    def _warm(self, run: AdmmRun | DataStepRun) -> Penalties:
        """Penalties that a frame starts from (decisions 7 and 18)."""
        if isinstance(run, DataStepRun):
            return data_step_start(self._problem, run.state, follows=True)
        if run.state.fraction_on_sensor() <= _MOST_LIGHT:
            return _WARM_SPILLING
        return _WARM if self._iterations >= CHECK_EVERY else _WARM_FEW


class Live:
    """Solves the newest frame of a camera, always, in a thread of its own.

    One frame waits at most. A newer one takes its place, and the older is counted as dropped: what
    is displayed is never older than the frame in work and the one that waits, and memory does not
    grow, however slow the solver is. Frames that cannot be solved for are counted as refused.

    Used as a context; at its end the frame that waits is still solved.

    Parameters
    ----------
    stream
        What solves; nobody else may use it meanwhile.
    show
        Called with every picture, in the thread of the solver. What it raises ends the thread, and
        is raised again at the end of the context.
    """

    def __init__(self, stream: Stream, show: Callable[[Frame], None]) -> None:
        self.dropped = 0
        self.refused = 0
        self._stream, self._show = stream, show
        self._waiting: tuple[Plane, Plane | None] | None = None
        self._ending = False
        self._failure: BaseException | None = None
        self._changed = Condition()
        self._thread = Thread(target=self._work, name="nolens-live", daemon=True)

    def __enter__(self) -> "Live":
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        with self._changed:
            self._ending = True
            self._changed.notify()
        self._thread.join()
        if self._failure is not None and error is None:
            raise self._failure

    def offer(self, data: Plane, valid: Plane | None = None) -> None:
        """Hand over the newest frame, and return at once.

        Parameters
        ----------
        data, valid
            As `Stream.solve` takes them; not to be changed afterwards.
        """
        with self._changed:
            self.dropped += self._waiting is not None
            self._waiting = data, valid
            self._changed.notify()

    def _next(self) -> tuple[Plane, Plane | None] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting is not None or self._ending)
            frame, self._waiting = self._waiting, None
            return frame

    def _work(self) -> None:
        try:
            while (frame := self._next()) is not None:
                try:
                    solved = self._stream.solve(*frame)
                except NolensError:
                    self.refused += 1
                    continue
                self._show(solved)
        except BaseException as failure:
            self._failure = failure


def check_frame_limits(iterations: int, latency_s: float | None) -> None:
    """Refuse limits of a frame within which nothing can be done.

    Raises
    ------
    OptionError
        If one of them is not above 0.
    """
    if iterations < 1:
        raise OptionError(f"iterations is {iterations}; a frame needs 1 or more")
    if latency_s is not None and not latency_s > 0:
        raise OptionError(f"latency_s is {latency_s:g}; it must be above 0")


def is_cut(residual: float, before: float) -> bool:
    """Whether a frame shows another scene than the one before it.

    Parameters
    ----------
    residual
        ‖b − x‖ / ‖b‖ of the frame, with the light x of the picture before it.
    before
        The same of the frame before.
    """
    return residual > 1 or residual > max(_CUT, _CUT_TIMES * before)


def _from_wiener(problem: Problem, penalties: Penalties) -> AdmmRun | DataStepRun:
    """A run that starts from what the circulant Wiener filter makes of the measurement alone, as
    bright as explains it best: where the sensor misses much light the filter's picture is too dark.
    """
    scene = circulant_wiener(replace(problem, tau=_WIENER_TAU)).scene / problem.scale
    light = torch.where(problem.valid, problem.forward(scene), 0)
    overlap, total = (light * problem.data).sum((-2, -1)), light.square().sum((-2, -1))
    brightness = (overlap / total.clamp_min(1e-30)).clamp_min(0)
    state = AdmmState.at(problem, scene * brightness[:, None, None], penalties)
    if problem.in_linear_step:
        state.restart(data_step_start(problem, state, follows=True))
    return start_run(problem, state)


class Deadline:
    """Stops a run with the last convergence check that fits into its time.

    Parameters
    ----------
    begun
        When the time began, as `time.perf_counter` says it.
    seconds
        How long it is; None for no end.
    """

    def __init__(self, begun: float, seconds: float | None) -> None:
        self._end = None if seconds is None else begun + seconds
        self._last = begun

    def __call__(self, progress: Progress) -> bool:
        """Whether a run ends at a check."""
        # The last stretch also has to undo the scaling, so twice the time of one is kept.
        return self.is_over(2 if progress.iteration > CHECK_EVERY else 0)

    def is_over(self, steps: int = 1) -> bool:
        """Whether there is no time for so many steps more that take as long as the last; asked
        after each.
        """
        now = time.perf_counter()
        ahead, self._last = now + steps * (now - self._last), now
        return self._end is not None and ahead > self._end
