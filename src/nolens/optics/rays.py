"""Ray transfer matrices: what surfaces and layers do to a paraxial ray."""

import math
from functools import reduce

import torch
from torch import Tensor

from nolens.optics.stack import Stack


def translation(thickness_um: float) -> Tensor:
    """Matrix of a layer: a ray (place, angle) goes on straight.

    Parameters
    ----------
    thickness_um
        Of the layer.

    Returns
    -------
    Tensor
        float64, (2, 2): [[1, t], [0, 1]] (`uvimprint`, eq. 1).
    """
    return torch.tensor([[1.0, thickness_um], [0.0, 1.0]], dtype=torch.float64)


def refraction(before: float, after: float, radius_um: float = math.inf) -> Tensor:
    """Matrix of a surface between two media.

    Parameters
    ----------
    before, after
        Refractive indices n₀ and n, in light's order.
    radius_um
        Radius of curvature R, positive where the surface bulges towards the light; infinite for a
        plane.

    Returns
    -------
    Tensor
        float64, (2, 2): [[1, 0], [(n₀ − n)/(R n), n₀/n]]. The paper prints the first row of it
        garbled (`uvimprint`, eq. 1 and 4).
    """
    power = (before - after) / (radius_um * after)
    return torch.tensor([[1.0, 0.0], [power, before / after]], dtype=torch.float64)


def through(matrices: list[Tensor]) -> Tensor:
    """Matrix of several parts that a ray passes in the order of the list."""
    return reduce(lambda system, part: part @ system, matrices)


def mask_to_sensor(before: float, after: Stack, radius_um: float) -> Tensor:
    r"""Matrix N from in front of the mask's surface to the sensor (`uvimprint`, eq. 1, 2 and 4).

    Parallel rays meet on the sensor where :math:`N_{11} = 1 - (n - n_0) D / R = 0`, with n the
    index of the first layer and :math:`D = Σ t_j / n_j` (`Stack.reduced_um`).

    Parameters
    ----------
    before
        Refractive index n₀ in front of the mask's surface.
    after
        The layers from that surface to the sensor.
    radius_um
        Radius of curvature of the mask's features, as in `refraction`.
    """
    parts = []
    index = before
    for number, (thickness_um, own) in enumerate(
        zip(after.thicknesses_um, after.indices, strict=True)
    ):
        parts += [
            refraction(index, own, radius_um if number == 0 else math.inf),
            translation(thickness_um),
        ]
        index = own
    return through(parts)
