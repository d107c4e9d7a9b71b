"""ADMM for eq. 7 with the paper's splitting: four real transforms an iteration."""

import math

import torch
from torch import Tensor

from nolens.errors import DataError, DivergenceError, OptionError
from nolens.kernels import (
    PassSums,
    SplitState,
    fft2_,
    ifft2_,
    in_large_pages,
    irfft2,
    rfft2,
    solve_normal_equation_,
    update_splits_,
)
from nolens.operators import FiniteDifference
from nolens.solvers.penalties import START, Balance, Penalties
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result, StopReason

_UNIFORM_START = 0.9
"""Share of the data that a uniform scene must explain for the iteration to start from it."""


def admm(
    problem: Problem,
    *,
    iterations: int = 100,
    tolerance: float = 3e-4,
    penalties: Penalties | None = None,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float = 1.8,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise ½‖b − CMv‖² + τ R(v), v ≥ 0, by the alternating direction method of multipliers.

    Splits x = Mv, u = Ψv, w = v with penalties μ₁, μ₂, μ₃ (`uvimprint`, eq. 7; `boyd2011`).
    Each iteration solves (μ₁MᵀM + μ₂ΨᵀΨ + μ₃) v = μ₁Mᵀq_x + μ₂Ψᵀq_u + μ₃q_w exactly in the
    Fourier domain and then updates every split by its proximal map, over-relaxed
    (`eckstein1992`). It starts from the uniform scene that fits best where that explains most
    of the data (a scene that fills the view: the glow is then right from the start), and from
    zero otherwise.

    Parameters
    ----------
    problem
        In unit norms; all channels are solved at once with the same penalties.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when, for every split, ‖Kv − x‖ ≤ tolerance · ‖x‖ (primal) and
        ‖x − x_before‖ ≤ tolerance · ‖x‖ (dual). 0 runs to the limit.
    penalties
        μ₁, μ₂, μ₃ to start with, > 0; None leaves the choice to the program.
    balance
        How the penalties are balanced as it runs; None keeps them.
    relaxation
        α in (0, 2).
    callback
        Called after every iteration; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DataError
        If the problem is not posed in float32.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    mu = START if penalties is None else penalties
    _check(problem, iterations, tolerance, mu, relaxation)
    states = _start(problem)
    if states[0].tv == 0:
        mu = (mu[0], 0.0, mu[2])  # There is no split u.
    pairs = [_first_pair(state, mu) for state in states]
    sums: list[PassSums] = []
    history: list[dict[str, float]] = []
    stop_reason: StopReason = "iteration limit"
    for iteration in range(1, iterations + 1):
        following = balance.next(mu, sums, iteration) if balance is not None else mu
        sums = []
        for channel, state in enumerate(states):
            pair = fft2_(pairs[channel])
            pair = solve_normal_equation_(pair, problem.transfer(channel), mu)
            pair = ifft2_(pair)
            pairs[channel], channel_sums = update_splits_(pair, state, mu, following, relaxation)
            sums.append(channel_sums)
        progress = _progress(problem, states, sums, iteration, mu, following)
        mu = following
        history.append(progress.row())
        if callback is not None and callback(progress):
            stop_reason = "callback"
            break
        if max(progress.primal_residual, progress.dual_residual) <= tolerance:
            stop_reason = "converged"
            break
    scene = _scene(problem, states, mu)
    return Result(
        scene=problem.unscale(scene),
        objective=problem.objective(scene),
        iterations=len(history),
        stop_reason=stop_reason,
        history=history,
    )


def _check(
    problem: Problem, iterations: int, tolerance: float, mu: Penalties, relaxation: float
) -> None:
    if problem.data.dtype != torch.float32:
        raise DataError(
            f"ADMM computes in float32, and the problem is posed in {problem.data.dtype}; "
            "pose it with float32 tensors"
        )
    if iterations < 1:
        raise OptionError(f"iterations is {iterations}; it must be 1 or more")
    if not tolerance >= 0:
        raise OptionError(f"tolerance is {tolerance:g}; it must be 0 or more")
    if not all(math.isfinite(each) and each > 0 for each in mu):
        raise OptionError(f"penalties are {mu}; each must be above 0")
    if not 0 < relaxation < 2:
        raise OptionError(f"relaxation is {relaxation:g}; it must lie between 0 and 2")


def _start(problem: Problem) -> list[SplitState]:
    """State of every channel, at a uniform scene or at zero."""
    levels = _uniform_levels(problem)
    geometry = problem.forward.geometry
    tv = problem.tau if problem.prior in (Prior.TV, Prior.ISOTROPIC_TV) else 0.0
    states = []
    for channel in range(problem.channels):
        data = problem.data[channel]
        scene = problem.forward.embed(data.new_full(geometry.scene[2:], levels[channel]))
        measured = irfft2(rfft2(scene) * problem.transfer(channel), geometry.period)
        gradient = FiniteDifference(geometry.period)(scene) if tv > 0 else data.new_empty(2, 0, 0)
        states.append(
            SplitState(
                data=data.contiguous(),
                valid=problem.valid[channel].to(torch.uint8).contiguous(),
                sensor=geometry.sensor,
                region=geometry.scene,
                tv=tv,
                isotropic=problem.prior is Prior.ISOTROPIC_TV,
                l1=problem.tau if problem.prior is Prior.L1 else 0.0,
                measured=in_large_pages(measured),
                rows=in_large_pages(gradient[0]),
                columns=in_large_pages(gradient[1]),
                scene=in_large_pages(scene),
            )
        )
    return states


def _uniform_levels(problem: Problem) -> list[float]:
    """Level c of each channel that minimises ‖b − c·CM1‖², or zeros where that explains little."""
    ones = problem.data.new_ones(problem.scene_shape)
    glow = torch.where(problem.valid, problem.forward(ones), 0).double()
    overlap = (glow * problem.data).sum(dim=(-2, -1))
    levels = overlap / glow.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    explained = float((levels * overlap).mean())  # of ‖b‖² = 1
    return levels.tolist() if explained > _UNIFORM_START else [0.0] * problem.channels


def _first_pair(state: SplitState, mu: Penalties) -> Tensor:
    """(q_x, r) of the start: an update that does not move."""
    still = in_large_pages(torch.zeros_like(state.scene, dtype=torch.complex64))
    pair, _ = update_splits_(still, state, mu, mu, 0.0)
    return pair


def _progress(
    problem: Problem,
    states: list[SplitState],
    sums: list[PassSums],
    iteration: int,
    mu: Penalties,
    following: Penalties,
) -> Progress:
    primal, dual = _residuals(problem, sums)
    values = [0.5 * each.misfit + problem.tau * _regulariser(problem.prior, each) for each in sums]
    objective = sum(values) / len(values)
    if not math.isfinite(objective + primal + dual):
        raise DivergenceError(
            f"the iteration gave NaN or infinity at step {iteration} (penalties {mu}); "
            "start from smaller penalties or a relaxation nearer 1"
        )
    return Progress(
        iteration=iteration,
        objective=objective,
        primal_residual=primal,
        dual_residual=dual,
        penalties=mu,
        scene=lambda: _scene(problem, states, following),
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


def _scene(problem: Problem, states: list[SplitState], mu: Penalties) -> Tensor:
    """The split w of every channel: non-negative, zero outside the region."""
    top, left, height, width = problem.forward.geometry.scene
    estimates = [state.estimate(mu[2])[top : top + height, left : left + width] for state in states]
    return torch.stack(estimates)
