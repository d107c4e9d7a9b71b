"""An objective Σ fᵢ(Kᵢv): what every solver of one asks of it, and how its runs start and end."""

import math
from collections.abc import Callable, Iterator, Sequence

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.solvers.functionals import Functional, Term
from nolens.solvers.result import Callback, Progress, Result, follow


def objective(functionals: Sequence[Functional], v: Tensor) -> float:
    """Σ fᵢ(Kᵢv); constraints that v does not meet exactly count as 0."""
    values = [float(each(v)) for each in functionals]
    return sum(value for value in values if value != math.inf)


def first_scene(functionals: Sequence[Functional]) -> Tensor:
    """Where to start: zero, or the uniform scene that fits best where a data term is infinite at 0.

    Raises
    ------
    OptionError
        If no functional is a data term.
    """
    for functional, operator in (each.parts for each in functionals):
        if functional.data is None:
            continue
        term = Term(functional, operator)
        scene = torch.zeros_like(term.back(functional.data))
        if functional.lipschitz == math.inf:
            image = term.image(torch.ones_like(scene))
            scene += (image * functional.data).sum() / image.square().sum().clamp_min(1e-30)
        return scene
    raise OptionError(
        "no functional has a measurement: give a data term, such as Gaussian(b) @ A, or a start"
    )


def energy(terms: Sequence[Term], like: Tensor) -> float:
    """What the data terms keep of white noise: Σ curvature · ‖Kn‖² / ‖n‖²; 1 without any.

    That is the mean eigenvalue of the data's Hessian but for the scene's mean, and the unit of a
    penalty. The largest, its Lipschitz constant, is thousands of times that of a positive PSF.
    """
    kept = sum(_gain(each, like) * each.functional.curvature for each in terms)
    return kept or 1.0


def _gain(term: Term, like: Tensor) -> float:
    if term.functional.curvature == 0:
        return 0.0
    generator = torch.Generator().manual_seed(0)
    noise = torch.randint(0, 2, like.shape, generator=generator).to(like) * 2 - 1
    noise -= noise.mean()
    image = term.image(noise)
    return float(image.square().sum() / noise.square().sum().clamp_min(1e-30))


def solve(
    steps: Iterator[Progress],
    value: Callable[[Tensor], float],
    *,
    iterations: int,
    tolerance: float,
    callback: Callback | None,
) -> Result:
    """Follow a run until its residuals are at most the tolerance; the scene that it ends with.

    Parameters
    ----------
    steps
        The run's convergence checks, up to the limit.
    value
        The objective of a scene.
    iterations, tolerance
        Limit, ≥ 1; 0 never stops for the residuals.
    callback
        Called at every convergence check; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    if iterations < 1 or not tolerance >= 0:
        raise OptionError(
            f"iterations is {iterations} and tolerance {tolerance:g}; they must be at least 1 and 0"
        )
    last: list[Progress] = []

    def kept() -> Iterator[Progress]:
        for progress in steps:
            last[:] = [progress]
            yield progress

    def has_ended(history: list[dict[str, float]]) -> bool:
        # The first step of a run from zero can be zero.
        return len(history) > 1 and last[0].residual <= tolerance

    history, reason = follow(kept(), has_ended, callback)
    scene = last[0].scene()
    return Result(
        scene=scene,
        objective=value(scene),
        iterations=last[0].iteration,
        stop_reason=reason,
        frame=(0, 0, *scene.shape[-2:]),
        history=history,
    )


def ratio(part: Tensor | float, whole: Tensor | float) -> float:
    """‖part‖ / ‖whole‖ from their norms; a part of zero is none of zero."""
    part, whole = float(part), float(whole)
    return 0.0 if part == 0 else part / whole if whole > 0 else 1.0
