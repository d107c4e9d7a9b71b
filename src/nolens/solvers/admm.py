"""ADMM for eq. 7 with the paper's splitting: four real transforms an iteration."""

import math
from collections.abc import Iterator
from dataclasses import replace

import torch
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.kernels import PassSums, Repeater, SplitState, in_large_pages, update_splits_
from nolens.process import release_memory
from nolens.solvers.admm_state import CHECK_EVERY, AdmmState, Balance, Penalties
from nolens.solvers.data_step import DATA_STEP_RELAXATION, DataStep, data_step_start
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result, expected_end, follow, has_converged

RELAXATION = 1.8
"""α where no other is given."""
_DATA_STEP_TOLERANCE = 1.5
"""Residuals at which a photo is done where the measurement is in the linear step, for each of
`scene_tolerance`: the picture's last steps there are noise that comes to rest."""
_BYTES_PER_PIXEL = 60
"""Held in the first and the last step, where a run holds most, per pixel of the padded shape."""
_DATA_STEP_BYTES_PER_PIXEL, _LINEAR_STEP_BYTES_PER_PIXEL, _IMAGE_BYTES_PER_VALUE = 26, 40, 36
"""Held where the measurement is in the linear step: of all channels, of that in work, and per value
of the measurement."""


def admm_bytes(
    pixels: float, channels: int, values: float, *, low_frequency: bool = False
) -> float:
    """Most memory that a run holds at once.

    Parameters
    ----------
    pixels
        `Problem.padded_pixels`, of all channels.
    channels
        Their number.
    values
        Of the measurement.
    low_frequency
        Whether the measurement is in the linear step.
    """
    if not low_frequency:
        return pixels * _BYTES_PER_PIXEL
    each = _DATA_STEP_BYTES_PER_PIXEL + _LINEAR_STEP_BYTES_PER_PIXEL / channels
    return pixels * each + values * _IMAGE_BYTES_PER_VALUE


class AdmmRun:
    """Advances a state, four iterations at a time.

    Parameters
    ----------
    problem
        In normalised units.
    state
        Where to start from; advanced in place.
    balance
        How the penalties are balanced from check to check; None keeps them.
    relaxation
        α in (0, 2).
    """

    def __init__(
        self, problem: Problem, state: AdmmState, *, balance: Balance | None, relaxation: float
    ) -> None:
        self._problem, self.state = problem, state
        self._balance, self._relaxation = balance, relaxation
        transfers = [problem.transfer(channel) for channel in range(problem.channels)]
        self._repeater = Repeater(state.splits, transfers, relaxation)
        self._pairs = _first_pairs(state)

    def measure(self, problem: Problem, penalties: Penalties) -> None:
        """Go on with another measurement of the same sizes, and count anew.

        Parameters
        ----------
        problem
            With the measurement.
        penalties
            To go on with.
        """
        before = self.state.penalties
        self.state.renew(problem, penalties)
        self._problem = problem
        if self.state.penalties != before:
            self._pairs = _first_pairs(self.state)
            return
        for pair, split in zip(self._pairs, self.state.splits, strict=True):
            _measure_again(pair, split, before[0])

    def to_check(self, limit: int) -> Progress:
        """Iterate until the next convergence check, four iterations on or at the limit.

        Parameters
        ----------
        limit
            Last iteration, counted from the state's beginning.

        Raises
        ------
        DivergenceError
            If an iterate is NaN or infinite.
        """
        state = self.state
        following = _balanced(state, self._balance)
        until_check = CHECK_EVERY - state.iteration % CHECK_EVERY
        count = min(until_check, limit - state.iteration)
        # Penalties change as soon as they can; the last iteration is the one with sums.
        first = [(state.penalties, following, False)] if count > 1 else []
        last = (following if first else state.penalties, following, True)
        steps = [*first, *[(following, following, False)] * (count - 2), last]
        self._pairs, state.sums = self._repeater.run(self._pairs, steps)
        state.penalties = following
        state.iteration += count
        return _progress(self._problem, state)

    def end(self) -> None:
        """Free the memory of the iterations."""
        self._pairs = []


class DataStepRun:
    """Advances a state, four iterations at a time, with the measurement in the linear step.

    Parameters
    ----------
    problem
        In normalised units.
    state
        Where to start from; advanced in place, its split x where the sensor is.
    balance, relaxation
        As `AdmmRun` takes them.
    """

    def __init__(
        self, problem: Problem, state: AdmmState, *, balance: Balance | None, relaxation: float
    ) -> None:
        self._problem, self.state = problem, state
        if balance is not None and not state.fills_view:
            balance = balance.in_the_dark
        self._balance = balance
        self._step: DataStep | None = DataStep(problem, state, relaxation)

    def measure(self, problem: Problem, penalties: Penalties) -> None:
        """Go on with another measurement, as `AdmmRun.measure`."""
        assert self._step is not None
        self.state.renew(problem, self.state.penalties)
        self.state.restart(penalties)  # The step keeps its own multipliers.
        self._step.measure(problem)
        self._problem = problem

    def to_check(self, limit: int) -> Progress:
        """Iterate until the next convergence check, as `AdmmRun.to_check`."""
        assert self._step is not None
        state = self.state
        state.penalties = _balanced(state, self._balance)
        count = min(CHECK_EVERY - state.iteration % CHECK_EVERY, limit - state.iteration)
        state.sums = self._step.iterate(count, state.penalties)
        state.iteration += count
        self._step.write(state)
        return _progress(self._problem, state)

    def end(self) -> None:
        """Free the memory of the iterations."""
        self._step = None


def start_run(
    problem: Problem,
    state: AdmmState,
    *,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float | None = None,
    low_frequency: bool = False,
) -> AdmmRun | DataStepRun:
    """The run that suits a problem: with the measurement in the linear step where it has to be.

    Parameters
    ----------
    problem, state, balance, relaxation
        As `admm` takes them.
    low_frequency
        Whether the measurement is in the linear step in any case.
    """
    if low_frequency or problem.in_linear_step:
        return DataStepRun(
            problem, state, balance=balance, relaxation=relaxation or DATA_STEP_RELAXATION
        )
    return AdmmRun(problem, state, balance=balance, relaxation=relaxation or RELAXATION)


def _balanced(state: AdmmState, balance: Balance | None) -> Penalties:
    """Penalties of the next iterations."""
    if balance is None or not state.sums:
        return state.penalties
    return balance.next(state.penalties, state.sums, state.iteration)


def _first_pairs(state: AdmmState) -> list[Tensor]:
    """(q_x, r) of every channel's splits: an update that does not move."""
    pairs = []
    for split in state.splits:
        still = in_large_pages(torch.zeros_like(split.scene, dtype=torch.complex64))
        pairs.append(
            update_splits_(still, split, state.penalties, state.penalties, 0.0, counted=False)[0]
        )
    return pairs


def _measure_again(pair: Tensor, split: SplitState, mu: float) -> None:
    """q_x = 2x − a on the sensor for another measurement: x = (b + μa)/(1 + μ) where it counts."""
    top, left, height, width = split.sensor
    inside = (slice(top, top + height), slice(left, left + width))
    stored = split.measured[inside]
    fitted = torch.lerp(split.data, stored, mu / (1 + mu))
    pair.real[inside] = torch.where(split.valid > 0, 2 * fitted - stored, stored)


def _progress(problem: Problem, state: AdmmState) -> Progress:
    sums, iteration = state.sums, state.iteration
    primal, dual = _residuals(problem, sums)
    moved = _ratio(sum(each.change[2] for each in sums), sum(each.split[2] for each in sums))
    values = [
        0.5 * each.residual + problem.tau * _regulariser(problem.prior, each) for each in sums
    ]
    objective = sum(values) / len(values)
    return Progress(
        iteration=iteration,
        objective=objective,
        primal_residual=primal,
        dual_residual=dual,
        scene_change=moved,
        penalties=state.penalties,
        scene=state.scene,
    )


def _regulariser(prior: Prior, sums: PassSums) -> float:
    if prior is Prior.L1:
        return sums.magnitude
    return 0.0 if prior is Prior.NONE else sums.variation


def _residuals(problem: Problem, sums: list[PassSums]) -> tuple[float, float]:
    """Largest relative residual of any split, over all channels together."""
    splits = (0, 1, 2) if problem.varied else (0, 2)
    primal = dual = 0.0
    for k in splits:
        split = sum(each.split[k] for each in sums)
        primal = max(primal, _ratio(sum(each.primal[k] for each in sums), split))
        dual = max(dual, _ratio(sum(each.change[k] for each in sums), split))
    return primal, dual


def _ratio(part: float, whole: float) -> float:
    """Root of part over whole; a split that is zero and stays so has no residual."""
    if part == 0:
        return 0.0
    return math.sqrt(part / whole) if whole > 0 else 1.0


def admm(
    problem: Problem,
    *,
    iterations: int = 100,
    tolerance: float = 3e-4,
    scene_tolerance: float = 0.0,
    low_frequency: bool = False,
    penalties: Penalties | None = None,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float | None = None,
    state: AdmmState | None = None,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise ½‖b − CMv‖² + τ R(v), v ≥ 0, by the alternating direction method of multipliers.

    Splits x = Mv, u = Ψv, w = v with penalties μ₁, μ₂, μ₃ (`uvimprint`, eq. 7; `boyd2011`).
    Each iteration solves (μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq_x + μ₂Ψᵀq_u + μ₃q_w exactly in the
    Fourier domain and then updates every split by its proximal map, over-relaxed
    (`eckstein1992`). It starts from the uniform scene that fits best where that explains most
    of the data (a scene that fills the view: the glow is then right from the start), and from
    zero otherwise.

    Every fourth iteration, and the last, is a convergence check: its residuals decide whether to
    stop and how the penalties go on, and the callback sees it.

    Parameters
    ----------
    problem
        In normalised units; all channels are solved at once with the same penalties.
    iterations
        Limit, ≥ 1; those that `state` has behind it count.
    tolerance
        Stops when, for every split, ‖Kv − x‖ ≤ tolerance · ‖x‖ (primal) and
        ‖x − x_before‖ ≤ tolerance · ‖x‖ (dual). 0 never stops for it.
    scene_tolerance
        Stops when the picture has at most scene_tolerance · ‖w‖ still to go, as its last steps
        predict (`nolens.solvers.result.still_to_go`), and no residual is above a third of it: the
        steps alone can be short while the penalties grow. 0 never stops for it.
    low_frequency
        Whether, where the scene fills the view, the measurement stays in the linear step
        (`DataStep`): the low frequencies of the scene are then there with its detail, and not
        hundreds of iterations later.
    penalties
        μ₁, μ₂, μ₃ to start with, > 0; None leaves the choice to the program.
    balance
        How the penalties are balanced as it runs; None keeps them.
    relaxation
        α in (0, 2); None takes what suits the splitting.
    state
        Where to start from, advanced in place; it has its own penalties. None starts cold.
    callback
        Called after every convergence check; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DataError
        If the problem is not in float32.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    _check(problem, iterations, tolerance, scene_tolerance, penalties, relaxation)
    if state is None:
        state = AdmmState.cold(problem, penalties)
    low_frequency = low_frequency and state.fills_view
    if low_frequency or problem.in_linear_step:
        if state.iteration == 0 and penalties is None:
            state.restart(data_step_start(problem, state))
        tolerance = max(tolerance, _DATA_STEP_TOLERANCE * scene_tolerance)
        scene_tolerance = 0.0
    else:
        problem = replace(problem, slow_light=True)
    run = start_run(
        problem, state, balance=balance, relaxation=relaxation, low_frequency=low_frequency
    )

    def has_ended(history: list[dict[str, float]]) -> bool:
        residual = max(history[-1]["primal_residual"], history[-1]["dual_residual"])
        return has_converged(history, scene_tolerance) or residual <= tolerance

    checks = _checks(run, iterations, max(tolerance, scene_tolerance / 3))
    history, stop_reason = follow(checks, has_ended, callback)
    run.end()
    release_memory()  # What follows needs it.
    scene = state.scene()
    if state.fills_view:
        scene, objective = problem.gain_corrected(scene)
    else:
        objective = problem.objective(scene)
    return Result(
        scene=problem.unscale(scene),
        objective=objective,
        iterations=state.iteration,
        stop_reason=stop_reason,
        frame=problem.frame,
        history=history,
    )


def _checks(run: AdmmRun | DataStepRun, limit: int, tolerance: float) -> Iterator[Progress]:
    """The run, with where it will end."""
    history: list[dict[str, float]] = []
    while run.state.iteration < limit:
        progress = run.to_check(limit)
        history.append(progress.row())
        end = expected_end(history, tolerance)
        yield progress if end is None else replace(progress, expected=min(end, limit))


def _check(
    problem: Problem,
    iterations: int,
    tolerance: float,
    scene_tolerance: float,
    mu: Penalties | None,
    relaxation: float | None,
) -> None:
    if problem.data.dtype != torch.float32:
        raise DataError(
            f"ADMM computes in float32, and the problem is in {problem.data.dtype}; "
            "build it from float32 tensors"
        )
    if iterations < 1:
        raise OptionError(f"iterations is {iterations}; it must be 1 or more")
    for name, value in (("tolerance", tolerance), ("scene_tolerance", scene_tolerance)):
        if not value >= 0:
            raise OptionError(f"{name} is {value:g}; it must be 0 or more")
    if mu is not None and not all(math.isfinite(each) and each > 0 for each in mu):
        raise OptionError(f"penalties are {mu}; each must be above 0")
    if relaxation is not None and not 0 < relaxation < 2:
        raise OptionError(f"relaxation is {relaxation:g}; it must lie between 0 and 2")
