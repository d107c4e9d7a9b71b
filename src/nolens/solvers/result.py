"""What a solver tells while it runs, and what it hands back."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from torch import Tensor

StopReason = Literal["converged", "iteration limit", "callback", "one shot"]


@dataclass(frozen=True)
class Progress:
    """A run at one of its looks, as a callback sees it.

    Parameters
    ----------
    iteration
        Counted from 1.
    objective
        Of the iterate as it stands, mean over channels, in unit norms (see `Problem`). An
        ADMM iterate is not exactly feasible before it has converged, so this can lie below
        the minimum; `Problem.objective(progress.scene())` is exact and costs two transforms.
    primal_residual, dual_residual
        Relative, as the stopping rule sees them.
    scene_change
        ‖w − w_before‖ / ‖w‖ of the last iteration: how far the picture still moves.
    penalties
        μ₁, μ₂, μ₃ of the iteration (ADMM; the step size for FISTA).
    scene
        Call it for the scene so far, feasible, `(channels, height, width)` in unit norms.
    """

    iteration: int
    objective: float
    primal_residual: float
    dual_residual: float
    scene_change: float
    penalties: tuple[float, ...]
    scene: Callable[[], Tensor]

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
"""Sees a run at every look; returns True to stop."""


@dataclass(frozen=True)
class Result:
    """A reconstruction.

    Parameters
    ----------
    scene
        Radiance on the scene's cells, `(channels, height, width)`, in units of the
        measurement over the PSF.
    objective
        Exact, of this scene: ½‖b − CMv‖² + τ·R(v) in unit norms, mean over channels.
    iterations, stop_reason
        How far it went, and why it stopped.
    history
        A row for each look (`Progress.row`).
    """

    scene: Tensor
    objective: float
    iterations: int
    stop_reason: StopReason
    history: list[dict[str, float]] = field(default_factory=list)
