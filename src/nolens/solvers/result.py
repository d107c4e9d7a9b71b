"""What a solver tells while it runs, and what it hands back."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from torch import Tensor

StopReason = Literal["converged", "iteration limit", "callback", "one shot"]


@dataclass(frozen=True)
class Progress:
    """A run at one of its convergence checks, as a callback sees it.

    Parameters
    ----------
    iteration
        Counted from 1.
    objective
        Of the iterate as it stands, mean over channels, in normalised units (see `Problem`). An
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
"""Called at every convergence check of a run; returns True to stop."""


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
    """

    scene: Tensor
    objective: float
    iterations: int
    stop_reason: StopReason
    frame: tuple[int, int, int, int]
    history: list[dict[str, float]] = field(default_factory=list)

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
