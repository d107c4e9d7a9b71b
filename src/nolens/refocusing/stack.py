"""Pictures of a scene at many depths."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.refocusing.solving import Solving
from nolens.solvers import Progress


@dataclass(frozen=True)
class Stack:
    """Pictures at depths.

    Parameters
    ----------
    depths_um
        The nearest first; the last may be infinite.
    pages
        Radiance, (depths, channels, rows, columns).
    objectives
        Of each page: how badly it explains the measurement (`nolens.solvers.Result`).
    """

    depths_um: tuple[float, ...]
    pages: Tensor
    objectives: tuple[float, ...]


def focal_stack(
    solving: Solving,
    psf_at: Callable[[float], Tensor],
    depths_um: Sequence[float],
    step: Callable[[int, int], bool] | None = None,
) -> Stack:
    """Reconstruct one measurement at many depths, each as if the whole scene lay there.

    Parameters
    ----------
    solving
        How every depth is reconstructed.
    psf_at
        PSF of a depth in um, (channels, rows, columns).
    depths_um
        From the nearest on.
    step
        Called after every convergence check with the iterations that are done and all there
        are; True ends the work, and the stack has the depths that are done.
    """
    pages: list[Tensor] = []
    objectives: list[float] = []
    for number, depth in enumerate(depths_um):
        ended = False

        def advance(progress: Progress, number: int = number) -> bool:
            nonlocal ended
            done = number * solving.iterations + progress.iteration
            ended = step is not None and step(done, len(depths_um) * solving.iterations)
            return ended

        psf = psf_at(depth)
        result = solving.solve(psf, advance)
        if ended and pages:
            break
        pages.append(result.photograph.cpu())
        objectives.append(result.objective)
        if ended:
            break
    return Stack(tuple(depths_um[: len(pages)]), torch.stack(pages), tuple(objectives))
