"""When a solver stops, what it reports while it runs, and what it hands back."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Literal

from torch import Tensor

from nolens.errors import DivergenceError

_STEP = 1e-3
"""Relative change of the picture in an iteration, up to which it stands still."""
_WAY = 0.1
"""Relative distance that it still has to go, up to which that hardly matters."""
StopReason = Literal["converged", "iteration limit", "callback", "one shot"]


class Quality(StrEnum):
    """What a picture is for.

    `DRAFT` is by the Wiener filter; for the others ADMM goes on until a `Stop`.
    """

    DRAFT = "draft"
    PHOTO = "photo"
    EXACT = "exact"


@dataclass(frozen=True)
class Stop:
    """When ADMM stops; the parameters are `admm`'s of these names."""

    iterations: int
    tolerance: float
    scene_tolerance: float
    low_frequency: bool


STOPS = {
    Quality.PHOTO: Stop(200, tolerance=0.0, scene_tolerance=1e-2, low_frequency=True),
    Quality.EXACT: Stop(5000, tolerance=1e-4, scene_tolerance=0.0, low_frequency=True),
}
"""A photo is done when it will no longer change visibly: by 1 % of its norm, as its last steps
predict, or, with the measurement in the linear step, when its residuals are about that (decision
7). Exact means that all relative residuals are at most 1e-4."""


@dataclass(frozen=True)
class Progress:
    """A run at one of its convergence checks, as a callback sees it.

    Parameters
    ----------
    iteration
        Counted from 1.
    objective
        Of the current iterate, mean over channels, in normalised units (see `Problem`). An
        ADMM iterate is not exactly feasible before it has converged, so this can lie below
        the minimum; `Problem.objective(progress.scene())` is exact and costs two transforms.
    primal_residual, dual_residual
        Relative, as the stopping rule sees them.
    scene_change
        ‖w − w_before‖ / ‖w‖ of the last iteration: how far the picture still moves.
    penalties
        μ₁, μ₂, μ₃ of the iteration (ADMM; the step size for FISTA).
    scene
        Call it for the scene so far, feasible, `(channels, height, width)` in normalised units.
    expected
        Iteration at which the run will end, as its last checks predict; None where they do not.

    Raises
    ------
    DivergenceError
        If the objective or a residual is NaN or infinite.
    """

    iteration: int
    objective: float
    primal_residual: float
    dual_residual: float
    scene_change: float
    penalties: tuple[float, ...]
    scene: Callable[[], Tensor]
    expected: int | None = None

    def __post_init__(self) -> None:
        if not math.isfinite(self.objective + self.primal_residual + self.dual_residual):
            raise DivergenceError(
                f"the iteration gave NaN or infinity by step {self.iteration} (penalties "
                f"{self.penalties}); start from smaller penalties or a relaxation nearer 1"
            )

    def end(self, limit: int) -> int:
        """The iteration at which the run will end: as its checks predict, or else at its limit.

        Parameters
        ----------
        limit
            Of the run; where iterations on larger pixels count, there can be more.
        """
        return max(self.iteration, self.expected or limit)

    @property
    def residual(self) -> float:
        """The larger of the two residuals."""
        return max(self.primal_residual, self.dual_residual)

    def row(self) -> dict[str, float]:
        """The iteration as a row of the run record."""
        return {
            "iteration": self.iteration,
            "objective": self.objective,
            "primal_residual": self.primal_residual,
            "dual_residual": self.dual_residual,
            "scene_change": self.scene_change,
            **{f"penalty_{k}": value for k, value in enumerate(self.penalties, start=1)},
        }


Callback = Callable[[Progress], bool | None]
"""Called at every convergence check of a run; returns True to stop."""


def follow(
    steps: Iterable[Progress],
    has_ended: Callable[[list[dict[str, float]]], bool],
    callback: Callback | None,
) -> tuple[list[dict[str, float]], StopReason]:
    """Follow a run from check to check until it ends; its rows, and why it did.

    Parameters
    ----------
    steps
        The run's convergence checks, up to the limit.
    has_ended
        Whether the rows so far are those of a run that has converged.
    callback
        Called at every check; stops the run by returning True.
    """
    history: list[dict[str, float]] = []
    for progress in steps:
        history.append(progress.row())
        if callback is not None and callback(progress):
            return history, "callback"
        if has_ended(history):
            return history, "converged"
    return history, "iteration limit"


@dataclass(frozen=True)
class Result:
    """A reconstruction.

    Parameters
    ----------
    scene
        Radiance on the scene's pixels, `(channels, height, width)`, in units of the
        measurement over the PSF. Without a support that is all that the sensor can see, so it is
        larger than the sensor's frame: `photograph` is the part within the sensor's frame.
    objective
        Exact, of this scene: ½‖b − CMv‖² + τ·R(v) in normalised units, mean over channels.
    iterations, stop_reason
        How far it went, and why it stopped.
    frame
        Window (top, left, height, width) of the scene that `photograph` is (`Problem.frame`).
    history
        A row for each convergence check (`Progress.row`).
    first
        The photograph by total variation that a trained prior, or one's own, started from; None for
        others.
    """

    scene: Tensor
    objective: float
    iterations: int
    stop_reason: StopReason
    frame: tuple[int, int, int, int]
    history: list[dict[str, float]] = field(default_factory=list)
    first: "Result | None" = field(default=None, repr=False)

    @property
    def photograph(self) -> Tensor:
        """The scene's support; without one, what lies in the sensor's frame."""
        top, left, height, width = self.frame
        return self.scene[..., top : top + height, left : left + width]

    def __repr__(self) -> str:
        scene = "×".join(str(side) for side in self.scene.shape)
        return (
            f"Result(scene {scene}, objective {self.objective:.4g}, {self.iterations} iterations, "
            f"{self.stop_reason})"
        )


def window_of(scene: Tensor, window: tuple[int, int, int, int]) -> Tensor:
    """A part (top, left, height, width) of a scene; dark where it reaches beyond."""
    top, left, height, width = window
    part = scene[..., max(top, 0) : max(top + height, 0), max(left, 0) : max(left + width, 0)]
    above, before = max(-top, 0), max(-left, 0)
    if part.shape[-2:] == (height, width):
        return part
    picture = scene.new_zeros(*scene.shape[:-2], height, width)
    picture[..., above : above + part.shape[-2], before : before + part.shape[-1]] = part
    return picture


def has_converged(history: list[dict[str, float]], tolerance: float) -> bool:
    """Whether the picture has at most tolerance · ‖w‖ still to go, and residuals agree.

    Parameters
    ----------
    history
        Rows of the convergence checks (`Progress.row`), one or more.
    tolerance
        Relative; a third of it for the residuals.
    """
    last = history[-1]
    residual = max(last["primal_residual"], last["dual_residual"])
    return still_to_go(history) <= tolerance and residual <= tolerance / 3


def still_to_go(history: list[dict[str, float]]) -> float:
    """Distance that the picture still has to go, relative to ‖w‖, if it goes on as it did.

    Steps c that shrink by the factor ρ from iteration to iteration have cρ/(1 − ρ) before them. ρ
    is taken from the last check and the one two before, as single checks scatter. Infinite where
    the steps do not shrink, or fewer checks were made.

    Parameters
    ----------
    history
        Rows of the convergence checks (`Progress.row`).
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


def stands_still(history: list[dict[str, float]]) -> bool:
    """Whether the picture hardly changes any more, or has hardly any way to go.

    Parameters
    ----------
    history
        Rows of the convergence checks (`Progress.row`), one or more.
    """
    return history[-1]["scene_change"] <= _STEP or still_to_go(history) <= _WAY


def expected_end(history: list[dict[str, float]], tolerance: float) -> int | None:
    """Iteration at which residuals come down to the tolerance, if they go on as they did.

    Parameters
    ----------
    history
        Rows of the convergence checks (`Progress.row`).
    tolerance
        Relative; 0 is never reached, infinity at the first check.

    Returns
    -------
    int
        None where the residual does not fall, or fewer than two checks were made.
    """
    if history and math.isinf(tolerance):
        return int(history[-1]["iteration"])
    if len(history) < 2 or tolerance <= 0:
        return None
    (first, before), (last, now) = (
        (row["iteration"], max(row["primal_residual"], row["dual_residual"]))
        for row in (history[0], history[-1])
    )
    if not 0 < now < before:
        return None
    left = math.log(max(now / tolerance, 1.0)) / math.log(before / now) * (last - first)
    return math.ceil(last + left)
