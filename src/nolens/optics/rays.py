"""Ray transfer matrices: what surfaces and layers do to a paraxial ray."""

import math
from collections.abc import Sequence
from functools import reduce

import torch
from torch import Tensor

from nolens.optics.stack import Stack

Number = float | Tensor
"""One value, or float64 values of any one shape, for which matrices stand in the last two axes."""


def translation(thickness_um: Number) -> Tensor:
    """Matrix of a layer: a ray (place, angle) goes on straight.

    Parameters
    ----------
    thickness_um
        Of the layer.

    Returns
    -------
    Tensor
        float64, (..., 2, 2): [[1, t], [0, 1]] (`uvimprint`, eq. 1).
    """
    return _matrix(1.0, thickness_um, 0.0, 1.0)


def refraction(before: Number, after: Number, radius_um: Number = math.inf) -> Tensor:
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
        float64, (..., 2, 2): [[1, 0], [(n₀ − n)/(R n), n₀/n]]. The paper prints the first row of
        it garbled (`uvimprint`, eq. 1 and 4).
    """
    # Autograd has no slope of a quotient whose divisor is infinite.
    plane = isinstance(radius_um, float) and math.isinf(radius_um)
    power = 0.0 if plane else (before - after) / (radius_um * after)
    return _matrix(1.0, 0.0, power, before / after)


def through(matrices: list[Tensor]) -> Tensor:
    """Matrix of several parts that a ray passes in the order of the list."""
    return reduce(lambda system, part: part @ system, matrices)


def through_layers(
    before: Number,
    thicknesses_um: Sequence[Number],
    indices: Sequence[Number],
    surface: int = 0,
    radius_um: Number = math.inf,
) -> Tensor:
    """Matrix of plane layers, of which one surface is curved.

    Parameters
    ----------
    before
        Refractive index in front of the first surface.
    thicknesses_um, indices
        Of the layers, in light's order.
    surface
        Number of the layer in front of which the curved surface lies.
    radius_um
        Its radius of curvature, as in `refraction`.

    Returns
    -------
    Tensor
        float64, (..., 2, 2), from in front of the first surface to the end of the last layer.
    """
    parts = []
    index = before
    for number, (thickness_um, own) in enumerate(zip(thicknesses_um, indices, strict=True)):
        parts += [
            refraction(index, own, radius_um if number == surface else math.inf),
            translation(thickness_um),
        ]
        index = own
    return through(parts)


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
    return through_layers(before, after.thicknesses_um, after.indices, 0, radius_um)


def _matrix(a: Number, b: Number, c: Number, d: Number) -> Tensor:
    values = [torch.as_tensor(each, dtype=torch.float64) for each in (a, b, c, d)]
    ones = torch.ones_like(values[0] + values[1] + values[2] + values[3])
    return torch.stack([value * ones for value in values], dim=-1).reshape(*ones.shape, 2, 2)
