"""A prior of one's own for a photograph, and the photograph with it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.operators import Diagonal
from nolens.plugins import Registry
from nolens.printable import quoted
from nolens.solvers.data_terms import Gaussian
from nolens.solvers.functionals import Functional, NonNegative
from nolens.solvers.held_out import channel_noise
from nolens.solvers.plug_and_play import PlugAndPlay
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result, Stop
from nolens.solvers.split_admm import split_admm

ScenePrior = Callable[[Tensor], Functional]
"""From a first photograph, (channels, height, width) with a white of about 1, to −ln p(v)."""

Row = dict[str, float]

TRAINED = {
    "ridge": "nolens.files.weights:ridge",
    "denoiser": "nolens.files.weights:denoiser",
    "unrolled": "nolens.files.weights:unrolled",
}
"""Priors that come with trained weights, and what loads them."""
PHOTO_PRIOR = "denoiser"
"""Of a photograph for which nothing else is said (decision 24)."""
SLOW_PRIOR = (
    f"the photo is by total variation: of so many pixels the trained prior ({PHOTO_PRIOR}) takes "
    f"minutes. State the prior {PHOTO_PRIOR} to have it all the same, or take larger pixels"
)


def by_total_variation(options: Sequence[str]) -> str | None:
    """What is said where options leave no room for the trained prior; None without any.

    Parameters
    ----------
    options
        Their names.
    """
    if not options:
        return None
    which = "that" if len(options) == 1 else "these"
    return (
        f"the photo is by total variation because of {' and '.join(options)}: without {which} it "
        f"is by the trained prior ({PHOTO_PRIOR})"
    )


_ADDED = Registry[Any](
    "nolens.priors",
    TRAINED,
    "prior",
    "function",
    callable,
)
_WHITE = 0.995
"""Fraction of the first photograph's values below its white."""
_TOLERANCE = 1e-3


def scene_prior(prior: Any) -> Prior | ScenePrior | PlugAndPlay:
    """A prior from a `Prior`, its text, a functional, a function that gives one, or a name.

    Names are those of trained priors, and those that packages add.

    Raises
    ------
    OptionError
        If it is none, or the package cannot be loaded.
    """
    if isinstance(prior, PlugAndPlay):
        return prior
    if isinstance(prior, Functional):
        return lambda _: prior
    if callable(prior):
        own: ScenePrior = prior
        return own
    if prior in tuple(Prior):
        return Prior(prior)
    if prior not in _ADDED.names:
        raise OptionError(
            f"prior is {quoted(str(prior))}; give one of {', '.join(PRIORS)}, a functional, or "
            "a function that gives one"
        )
    added = _ADDED.load(prior)
    return scene_prior(added() if prior in TRAINED else added)


PRIORS = (*(each.value for each in Prior), *_ADDED.names)
"""Names of those of nolens, and of those that other packages add."""


@dataclass(frozen=True)
class WeakerPrior:
    """A prior whose functional is divided by `detail`."""

    prior: ScenePrior
    detail: float

    def __call__(self, first: Tensor) -> Functional:
        """The functional, from a first photograph."""
        return (1 / self.detail) * self.prior(first)


def solve_with(
    prior: ScenePrior, problem: Problem, first: Result, stop: Stop, callback: Callback | None
) -> Result:
    r"""The most probable scene: minimise ½Σ((b − Av)/σ)² + f(v) over v ≥ 0, from a first result.

    σ is the noise of each channel, and v has the first result's white as 1, so that f means the
    same for every camera and exposure.

    Parameters
    ----------
    prior
        Gives f, such as ``lambda first: 0.5 * Denoiser(...)``.
    problem
        What was solved for the first result.
    first
        Where to start from.
    stop
        Its limit, and its tolerance: where that is 0, as for a photo, residuals of a thousandth.
    callback
        Sees the run, with scenes in the problem's units.

    Raises
    ------
    OptionError
        If the prior gives no functional.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    white = torch.quantile(first.scene.flatten()[:: 1 + first.scene.numel() // 10**6], _WHITE)
    white = white if white > 0 else white.new_tensor(1.0)
    start = first.scene / white
    functional = prior(start)
    if not isinstance(functional, Functional):
        raise OptionError(
            f"the prior gave {type(functional).__name__}; it must give a Functional, such as "
            "0.1 * TotalVariation(first.shape)"
        )
    units = Diagonal((white / problem.scale).expand(start.shape))
    # All of it times a mean variance: without noise its inverse would be beyond float32.
    noise = channel_noise(problem)[:, None, None].square()
    variance = float(noise.mean())
    measured = problem.counted(problem.data)
    data = Gaussian(measured, weights=variance / noise, valid=problem.valid)

    def later(row: Row) -> Row:
        """A row of the run, counted on from the first result's."""
        iteration = row["iteration"] + first.iterations
        return {**row, "iteration": iteration, "objective": row["objective"] / variance}

    def seen(progress: Progress) -> bool | None:
        assert callback is not None
        row = later(progress.row())
        return callback(
            replace(
                progress,
                iteration=int(row["iteration"]),
                objective=row["objective"],
                scene=lambda: units(progress.scene()),
            )
        )

    result = split_admm(
        data @ (problem.counted_forward @ units),
        variance * functional,
        NonNegative(),
        start=start,
        iterations=stop.iterations,
        tolerance=stop.tolerance or _TOLERANCE,
        callback=None if callback is None else seen,
    )
    return replace(
        result,
        scene=result.scene * white,
        objective=result.objective / variance,
        iterations=first.iterations + result.iterations,
        frame=problem.frame,
        history=[later(row) for row in result.history],
        first=first,
    )
