"""Plane layers at one wavelength: what Snell's law does to a ray, and Fresnel's to its power.

A ray is known by p = n sin θ, which every plane layer conserves (Snell's law); in air it is the
sine of the field angle.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

_MOST_STEPS = 30
_CLOSE = 1e-13


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
        the displacement is close to linear.

        Parameters
        ----------
        displacement_um
            float64, any shape.
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
