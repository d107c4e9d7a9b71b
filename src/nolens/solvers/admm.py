"""ADMM for eq. 7 with the paper's splitting: four real transforms an iteration."""

import math

import torch
from torch import Tensor

from nolens.errors import DataError, DivergenceError, OptionError
from nolens.kernels import (
    PassSums,
    Repeater,
    fft2_,
    ifft2_,
    in_large_pages,
    solve_normal_equation_,
    update_splits_,
)
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.penalties import LOOK, Balance, Penalties
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result, StopReason
from nolens.solvers.smooth_part import SmoothPart

_SMOOTH_AT = 12
"""Look at which the smooth part is solved for: detail is there, and penalties are still small."""


def admm(
    problem: Problem,
    *,
    iterations: int = 100,
    tolerance: float = 3e-4,
    scene_tolerance: float = 0.0,
    smooth_part: bool = False,
    penalties: Penalties | None = None,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float = 1.8,
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

    Every fourth iteration, and the last, is looked at: its residuals decide whether to stop and
    how the penalties go on, and the callback sees it.

    Parameters
    ----------
    problem
        In unit norms; all channels are solved at once with the same penalties.
    iterations
        Limit, ≥ 1; those that `state` has behind it count.
    tolerance
        Stops when, for every split, ‖Kv − x‖ ≤ tolerance · ‖x‖ (primal) and
        ‖x − x_before‖ ≤ tolerance · ‖x‖ (dual). 0 never stops for it.
    scene_tolerance
        Stops when the picture has at most scene_tolerance · ‖w‖ still to go, as its last steps
        foretell (`still_to_go`), and no residual is above a third of it: the steps alone can be
        short while the penalties grow. 0 never stops for it.
    smooth_part
        Whether, where the scene fills the view, its smooth part is solved for directly
        (`SmoothPart`): once on the way, which saves hundreds of iterations, and in the end.
    penalties
        μ₁, μ₂, μ₃ to start with, > 0; None leaves the choice to the program.
    balance
        How the penalties are balanced as it runs; None keeps them.
    relaxation
        α in (0, 2).
    state
        Where to start from, advanced in place; it has its own penalties. None starts cold.
    callback
        Called after every look; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DataError
        If the problem is not posed in float32.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    _check(problem, iterations, tolerance, scene_tolerance, penalties, relaxation)
    if state is None:
        state = AdmmState.cold(problem, penalties)
    smooth = SmoothPart(problem) if smooth_part and state.fills_view else None
    transfers = [problem.transfer(channel) for channel in range(problem.channels)]
    repeater = Repeater(state.splits, transfers, relaxation)
    pairs = _first_pairs(state)
    history: list[dict[str, float]] = []
    stop_reason: StopReason = "iteration limit"
    while state.iteration < iterations:
        mu = state.penalties
        following = mu
        if balance is not None and state.sums:
            following = balance.next(mu, state.sums, state.iteration)
        last = min(iterations, state.iteration - state.iteration % LOOK + LOOK)
        if following != mu and state.iteration + 1 < last:
            pairs = _iterate(problem, state, pairs, following, relaxation, look=False)
        pairs = repeater.run(pairs, state.penalties, last - 1 - state.iteration)
        state.iteration = last - 1
        pairs = _iterate(problem, state, pairs, following, relaxation, look=True)
        progress = _progress(problem, state)
        history.append(progress.row())
        if callback is not None and callback(progress):
            stop_reason = "callback"
            break
        stands = (
            still_to_go(history) <= scene_tolerance and progress.residual <= scene_tolerance / 3
        )
        if stands or progress.residual <= tolerance:
            stop_reason = "converged"
            break
        if smooth is not None and state.iteration == _SMOOTH_AT:
            before = state.scene(problem)
            after, better = smooth.improved(before)
            if better:
                state.move_(problem, after - before)
                pairs = _first_pairs(state)
            else:
                smooth = None  # The model is not that exact: ADMM's own way is the better one.
    pairs.clear()  # What follows needs their memory.
    scene = state.scene(problem)
    if smooth is not None:
        scene, _ = smooth.improved(scene)
    scene, objective = _levelled(problem, scene) if state.fills_view else (scene, None)
    return Result(
        scene=problem.unscale(scene),
        objective=problem.objective(scene) if objective is None else objective,
        iterations=state.iteration,
        stop_reason=stop_reason,
        history=history,
    )


def _levelled(problem: Problem, scene: Tensor) -> tuple[Tensor, float]:
    """Every channel times the factor that fits the data best, and the objective, if that falls.

    The iterate's mean is held by all cells that it is seen through, and comes to rest last: it can
    be some per cent off, each channel in its own way, when the picture has long been there.
    """
    residual = problem.residual(scene)
    objective = problem.objective(scene, residual)
    seen = torch.where(problem.valid, problem.data - residual, 0).double()
    norms = seen.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    factor = ((seen * problem.data).sum(dim=(-2, -1)) / norms).to(scene.dtype)[:, None, None]
    if bool((factor > 0).all()):
        level = factor * scene
        there = problem.objective(level, problem.data - factor * (problem.data - residual))
        if there < objective:
            return level, there
    return scene, objective


def still_to_go(history: list[dict[str, float]]) -> float:
    """Distance that the picture still has to go, relative to ‖w‖, if it goes on as it did.

    Steps c that shrink by the factor ρ from iteration to iteration have cρ/(1 − ρ) before them. ρ
    is taken from the last look and the one two before, as single looks scatter. Infinite where
    the steps do not shrink, or fewer looks were taken.

    Parameters
    ----------
    history
        Rows of the looks (`Progress.row`).
    """
    if len(history) < 3:
        return math.inf
    before, now = history[-3], history[-1]
    if now["scene_change"] == 0:
        return 0.0
    if before["scene_change"] <= now["scene_change"]:
        return math.inf
    span = now["iteration"] - before["iteration"]
    rate = math.pow(now["scene_change"] / before["scene_change"], 1 / span)
    return now["scene_change"] * rate / (1 - rate)


def _iterate(
    problem: Problem,
    state: AdmmState,
    pairs: list[Tensor],
    following: Penalties,
    relaxation: float,
    *,
    look: bool,
) -> list[Tensor]:
    """One iteration of every channel, after which the penalties are `following`."""
    mu, sums, done = state.penalties, [], []
    for channel, split in enumerate(state.splits):
        pair = fft2_(pairs[channel])
        pair = solve_normal_equation_(pair, problem.transfer(channel), mu)
        pair = ifft2_(pair)
        pair, counted = update_splits_(pair, split, mu, following, relaxation, counted=look)
        done.append(pair)
        if counted is not None:
            sums.append(counted)
    state.penalties = following
    state.iteration += 1
    if look:
        state.sums = sums
    return done


def _check(
    problem: Problem,
    iterations: int,
    tolerance: float,
    scene_tolerance: float,
    mu: Penalties | None,
    relaxation: float,
) -> None:
    if problem.data.dtype != torch.float32:
        raise DataError(
            f"ADMM computes in float32, and the problem is posed in {problem.data.dtype}; "
            "pose it with float32 tensors"
        )
    if iterations < 1:
        raise OptionError(f"iterations is {iterations}; it must be 1 or more")
    for name, value in (("tolerance", tolerance), ("scene_tolerance", scene_tolerance)):
        if not value >= 0:
            raise OptionError(f"{name} is {value:g}; it must be 0 or more")
    if mu is not None and not all(math.isfinite(each) and each > 0 for each in mu):
        raise OptionError(f"penalties are {mu}; each must be above 0")
    if not 0 < relaxation < 2:
        raise OptionError(f"relaxation is {relaxation:g}; it must lie between 0 and 2")


def _first_pairs(state: AdmmState) -> list[Tensor]:
    """(q_x, r) of every channel's splits: an update that does not move."""
    pairs = []
    for split in state.splits:
        still = in_large_pages(torch.zeros_like(split.scene, dtype=torch.complex64))
        pairs.append(
            update_splits_(still, split, state.penalties, state.penalties, 0.0, counted=False)[0]
        )
    return pairs


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
        scene=lambda: state.scene(problem),
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
