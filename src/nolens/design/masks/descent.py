"""The descent that all designed reliefs come from."""

import math
from collections.abc import Callable

import torch
from torch import Tensor

from nolens.design.masks.limits import Limits
from nolens.design.masks.tile import Tile

_STEP_UM = 0.1


def descend(
    tile: Tile,
    start_um: Tensor,
    limits: Limits,
    loss: Callable[[Tensor], Tensor],
    *,
    iterations: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    r"""Relief whose PSFs have a small loss, within limits.

    Adam (`kingma2015`) with a step that falls to zero by a cosine, on a surface that is blurred to
    the smallest feature and rounded to the levels (with the gradient of the unrounded one);
    slope and height enter as penalties on the way, and hold exactly in the end
    (`Limits.enforce`).

    Parameters
    ----------
    tile
        Piece of the mask, with the light that counts.
    start_um
        Surface to begin with, (side, side).
    limits
        Of the process.
    loss
        Of one view's PSF.
    iterations
        How many steps.
    stop
        Called with the number of steps that are done; True ends the descent there.

    Returns
    -------
    Tensor
        Heights in um from 0 on, (side, side).
    """
    raw = start_um.clone().requires_grad_(True)
    adam = torch.optim.Adam([raw], lr=_STEP_UM, betas=(0.9, 0.99))
    for number in range(iterations):
        for group in adam.param_groups:
            group["lr"] = _STEP_UM * (1 + math.cos(math.pi * number / iterations)) / 2
        surface = limits.smooth(raw, tile.grid_um)
        gradient = torch.autograd.grad(limits.excess(surface, tile.grid_um), surface)[0]
        # One view at a time, so that only one is held in memory.
        made = limits.quantised(surface.detach()).requires_grad_(True)
        for view, each in enumerate(tile.views):
            part = each.weight * loss(tile.pattern(made, view))
            gradient = gradient + torch.autograd.grad(part, made)[0]
        raw.grad = torch.autograd.grad(surface, raw, gradient)[0]
        adam.step()
        if stop is not None and stop(number + 1):
            break
    with torch.no_grad():
        return limits.enforce(limits.smooth(raw, tile.grid_um), tile.grid_um)
