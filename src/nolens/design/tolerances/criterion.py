"""A criterion as a plain function, and its evaluation in portions."""

from collections.abc import Callable

import torch
from torch import Tensor

Criterion = Callable[[Tensor], Tensor]
"""From cameras (trials, parameters), each parameter in its unit, to their figure (trials,)."""


def evaluate(
    criterion: Criterion,
    cameras: Tensor,
    *,
    at_once: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    """Evaluate cameras in portions.

    Parameters
    ----------
    criterion
        To be evaluated.
    cameras
        (trials, parameters).
    at_once
        Cameras in a portion.
    stop
        Called with the number that is done after every portion; True ends the work.

    Returns
    -------
    Tensor
        float64, one figure for each camera that was done.
    """
    found = []
    for first in range(0, len(cameras), at_once):
        found.append(criterion(cameras[first : first + at_once]).double())
        if stop is not None and stop(min(first + at_once, len(cameras))):
            break
    return torch.cat(found)
