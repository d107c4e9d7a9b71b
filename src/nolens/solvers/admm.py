"""ADMM for eq. 7 with the paper's splitting: four real transforms an iteration."""

import math

import torch

from nolens.errors import DataError, OptionError
from nolens.solvers.admm_run import AdmmRun
from nolens.solvers.admm_state import AdmmState
from nolens.solvers.level import levelled
from nolens.solvers.penalties import Balance, Penalties
from nolens.solvers.problem import Problem
from nolens.solvers.result import Callback, Result, StopReason
from nolens.solvers.smooth_part import SmoothPart

RELAXATION = 1.8
"""α of a run that is not told another."""
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
    relaxation: float = RELAXATION,
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
    run = AdmmRun(problem, state, balance=balance, relaxation=relaxation)
    history: list[dict[str, float]] = []
    stop_reason: StopReason = "iteration limit"
    while state.iteration < iterations:
        progress = run.to_look(iterations)
        history.append(progress.row())
        if callback is not None and callback(progress):
            stop_reason = "callback"
            break
        if stands(history, scene_tolerance) or progress.residual <= tolerance:
            stop_reason = "converged"
            break
        if smooth is not None and state.iteration == _SMOOTH_AT:
            before = state.scene()
            after, better = smooth.improved(before)
            if better:
                state.move_(problem, after - before)
                run.restart()
            else:
                smooth = None  # The model is not that exact: ADMM's own way is the better one.
    run.end()  # What follows needs its memory.
    scene = state.scene()
    if smooth is not None:
        scene, _ = smooth.improved(scene)
    if state.fills_view:
        scene, objective = levelled(problem, scene)
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


def stands(history: list[dict[str, float]], tolerance: float) -> bool:
    """Whether the picture has at most tolerance · ‖w‖ still to go, and residuals agree.

    Parameters
    ----------
    history
        Rows of the looks (`Progress.row`), one or more.
    tolerance
        Relative; a third of it for the residuals.
    """
    last = history[-1]
    residual = max(last["primal_residual"], last["dual_residual"])
    return still_to_go(history) <= tolerance and residual <= tolerance / 3


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
