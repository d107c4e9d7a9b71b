"""Plane layers: what they do to exact rays and their power, and to paraxial rays as matrices.

An exact ray is known by p = n sin θ, which every plane layer conserves (Snell's law); in air it is
the sine of the field angle.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise

import torch
from torch import Tensor

_MOST_STEPS = 30
_CLOSE = 1e-13

Number = float | Tensor
"""One value, or float64 values of any one shape, for which matrices stand in the last two axes."""


@dataclass(frozen=True)
class Stack:
    """Plane layers that light passes one after the other.

    Parameters
    ----------
    thicknesses_um
        Of the layers, in light's order.
    indices
        Their refractive indices.
    """

    thicknesses_um: tuple[float, ...]
    indices: tuple[float, ...]

    @property
    def reduced_um(self) -> float:
        """Σ thickness / index: the layers' length to paraxial rays."""
        pairs = zip(self.thicknesses_um, self.indices, strict=True)
        return sum(thickness / index for thickness, index in pairs)

    @property
    def critical(self) -> float:
        """Value of p from which on a layer carries no light."""
        return min(self.indices)

    def then(self, other: "Stack") -> "Stack":
        """These layers, and after them the other ones."""
        return Stack(self.thicknesses_um + other.thicknesses_um, self.indices + other.indices)

    def displacement_um(self, p: Tensor) -> Tensor:
        """How far a ray moves sideways: Σ t p / √(n² − p²)."""
        terms = (t * p / (n * n - p * p).sqrt() for t, n in self._layers())
        return sum(terms, torch.zeros_like(p))

    def spread_um(self, p: Tensor) -> Tensor:
        """How fast the displacement grows with p: Σ t n² / (n² − p²)^(3/2)."""
        terms = (t * n * n / (n * n - p * p).pow(1.5) for t, n in self._layers())
        return sum(terms, torch.zeros_like(p))

    def axial_um(self, squared: Tensor) -> Tensor:
        """Optical path along the axis, Σ t √(n² − p²), from p².

        Beyond the critical value a layer counts nothing.
        """
        terms = (t * (n * n - squared).clamp_min(0).sqrt() for t, n in self._layers())
        return sum(terms, torch.zeros_like(squared))

    def ray(self, displacement_um: Tensor) -> Tensor:
        """Give p of the ray that moves sideways by so much ≥ 0: inverse of `displacement_um`.

        Newton's method on the tangent of the ray in the layer of the smallest index, in which
        the displacement is close to linear. The displacement is float64, of any shape.
        """
        slowest = self.critical
        tangent = displacement_um / self.reduced_um / slowest
        for _ in range(_MOST_STEPS):
            p = slowest * tangent / (1 + tangent * tangent).sqrt()
            cosine = (1 + tangent * tangent).rsqrt()
            slope = self.spread_um(p) * slowest * cosine**3
            before = tangent
            tangent = (tangent - (self.displacement_um(p) - displacement_um) / slope).clamp_min(0)
            if bool(((tangent - before).abs() <= _CLOSE * (1 + tangent)).all()):
                break
        return slowest * tangent / (1 + tangent * tangent).sqrt()

    def _layers(self) -> Iterator[tuple[float, float]]:
        return zip(self.thicknesses_um, self.indices, strict=True)


def transmittance(indices: tuple[float, ...], squared: Tensor) -> Tensor:
    r"""Fraction of the power of unpolarised light that passes the surfaces between media.

    At one surface :math:`T = 1 - \tfrac12(r_s^2 + r_p^2)` with Fresnel's coefficients
    (`goodman2005`); light that is reflected twice is not followed.

    Parameters
    ----------
    indices
        Of the media, in light's order, from the scene's to the sensor's.
    squared
        p², float64, any shape, below the square of every index.
    """
    passed = torch.ones_like(squared)
    for before, after in pairwise(indices):
        near = (before * before - squared).clamp_min(0).sqrt()
        far = (after * after - squared).clamp_min(0).sqrt()
        across = (near - far) / (near + far)
        flipped_near, flipped_far = near * (after / before), far * (before / after)
        along = (flipped_near - flipped_far) / (flipped_near + flipped_far)
        passed = passed * (1 - (across**2 + along**2) / 2)
    return passed


def translation(thickness_um: Number) -> Tensor:
    """Matrix of a layer, float64: a ray (place, angle) goes on straight.

    [[1, t], [0, 1]] (`uvimprint`, eq. 1).
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
    index of the first layer, n₀ that in front of the mask's surface, R the radius of curvature of
    its features, as in `refraction`, and :math:`D = Σ t_j / n_j` (`Stack.reduced_um`).
    """
    return through_layers(before, after.thicknesses_um, after.indices, 0, radius_um)


def _matrix(a: Number, b: Number, c: Number, d: Number) -> Tensor:
    values = [torch.as_tensor(each, dtype=torch.float64) for each in (a, b, c, d)]
    ones = torch.ones_like(values[0] + values[1] + values[2] + values[3])
    return torch.stack([value * ones for value in values], dim=-1).reshape(*ones.shape, 2, 2)
