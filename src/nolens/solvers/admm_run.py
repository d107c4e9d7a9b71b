"""Iterations of ADMM from a state, from one look to the next."""

import math

import torch
from torch import Tensor

from nolens.errors import DivergenceError
from nolens.kernels import (
    PassSums,
    Repeater,
    SplitState,
    in_large_pages,
    update_splits_,
)
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.penalties import LOOK, Balance, Penalties
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Progress


class AdmmRun:
    """Advances a state, four iterations at a time.

    Parameters
    ----------
    problem
        In unit norms.
    state
        Where to start from; advanced in place.
    balance
        How the penalties are balanced from look to look; None keeps them.
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
        self._pairs: list[Tensor] = []
        self.restart()

    def restart(self) -> None:
        """Go on from what the state has become, after it was changed by others."""
        self._pairs = _first_pairs(self.state)

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
            self.restart()
            return
        for pair, split in zip(self._pairs, self.state.splits, strict=True):
            _measure_again(pair, split, before[0])

    def to_look(self, limit: int) -> Progress:
        """Iterate until the next look, four iterations on or at the limit.

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
        following = state.penalties
        if self._balance is not None and state.sums:
            following = self._balance.next(state.penalties, state.sums, state.iteration)
        count = min(limit, state.iteration - state.iteration % LOOK + LOOK) - state.iteration
        # Penalties change as soon as they can; the last iteration is the one that is looked at.
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
    met = torch.lerp(split.data, stored, mu / (1 + mu))
    pair.real[inside] = torch.where(split.valid > 0, 2 * met - stored, stored)


def _progress(problem: Problem, state: AdmmState) -> Progress:
    sums, iteration = state.sums, state.iteration
    primal, dual = _residuals(problem, sums)
    moved = _ratio(sum(each.change[2] for each in sums), sum(each.split[2] for each in sums))
    values = [0.5 * each.misfit + problem.tau * _regulariser(problem.prior, each) for each in sums]
    objective = sum(values) / len(values)
    if not math.isfinite(objective + primal + dual):
        raise DivergenceError(
            f"the iteration gave NaN or infinity by step {iteration} (penalties "
            f"{state.penalties}); start from smaller penalties or a relaxation nearer 1"
        )
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
    splits = (0, 1, 2) if problem.prior in (Prior.TV, Prior.ISOTROPIC_TV) else (0, 2)
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
