"""How thick a layer must be, or how curved its lenslets, for a point source to be sharp."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.optics import Number, through, through_layers, translation

_STEP_UM = 1000.0


@dataclass(frozen=True)
class LensletStack:
    """Layers over a sensor, on one of whose surfaces lenslets lie.

    The imprinted camera of the paper has them on the first surface (`uvimprint`, fig. 2b), its
    film likewise (fig. 2a); a film whose relief faces the sensor has them on its back, in front of
    the layer of air behind it. Values may be tensors of one shape, and are followed by autograd.

    Parameters
    ----------
    thicknesses_um, indices
        Of all layers, from the scene to the sensor.
    surface
        Number of the layer in front of which the lenslets lie.
    radius_um
        Their radius of curvature, positive: the lenslets of the denser of the two media are
        convex, whichever side it is on.
    source_um
        Distance from the point source to the first surface; infinite for parallel rays.
    outside
        Refractive index in front of the first surface.
    """

    thicknesses_um: tuple[Number, ...]
    indices: tuple[Number, ...]
    surface: int
    radius_um: Number
    source_um: float = math.inf
    outside: Number = 1.0

    def matrix(self) -> Tensor:
        """Ray matrix from the source, or of a far one from the first surface, to the sensor.

        Returns
        -------
        Tensor
            float64, (..., 2, 2) (`uvimprint`, eq. 1 and 4).
        """
        return self._from_source(
            through_layers(
                self.outside, self.thicknesses_um, self.indices, self.surface, self.signed_radius_um
            )
        )

    @property
    def before(self) -> Number:
        """Refractive index in front of the lenslets."""
        return self.indices[self.surface - 1] if self.surface else self.outside

    @property
    def signed_radius_um(self) -> Tensor:
        """Radius as `nolens.optics.refraction` takes it: positive if bulging to the scene."""
        step = torch.as_tensor(self.indices[self.surface] - self.before, dtype=torch.float64)
        return torch.where(step < 0, -torch.ones_like(step), 1.0) * self.radius_um

    @property
    def focal_length_um(self) -> Tensor:
        r"""Focal length as in air, :math:`f = R / |n - n_0|` (`uvimprint`, eq. 1)."""
        step = torch.as_tensor(self.indices[self.surface] - self.before, dtype=torch.float64)
        return self.radius_um / step.abs()

    @property
    def behind_um(self) -> Number:
        """Reduced thickness D = Σ t/n from the lenslets to the sensor."""
        pairs = zip(self.thicknesses_um, self.indices, strict=True)
        reduced: list[Number] = [thickness / index for thickness, index in pairs]
        return sum(reduced[self.surface + 1 :], reduced[self.surface])

    @property
    def blur(self) -> Tensor:
        r"""Width of a pencil of rays on the sensor, over its width at the lenslet; 0 in focus.

        :math:`N_{11}` of the matrix for a far source, and :math:`N_{12} / L` for one whose light
        has the reduced length L behind it at the lenslet. Positive where the sensor lies in front
        of the focus.
        """
        if math.isinf(self.source_um):
            return self._error()
        before = slice(self.surface)
        way = translation(self.source_um)
        if self.surface:
            way = self._from_source(
                through_layers(self.outside, self.thicknesses_um[before], self.indices[before])
            )
        return self._error() / way[..., 0, 1]

    def focused_thickness_um(self, layer: int) -> Tensor:
        """Thickness of one layer that brings the source to focus on the sensor.

        The element of the matrix that must vanish is linear in the thickness of every layer, so
        two values of it give the root without approximation.

        Parameters
        ----------
        layer
            Number of the layer; its thickness here does not matter.

        Returns
        -------
        Tensor
            float64; zero or less where no thickness does.

        Raises
        ------
        OptionError
            If the thickness of this layer does not move the focus.
        """
        without, with_step = (
            replace(
                self,
                thicknesses_um=(
                    *self.thicknesses_um[:layer],
                    value,
                    *self.thicknesses_um[layer + 1 :],
                ),
            )._error()
            for value in (0.0, _STEP_UM)
        )
        if bool((without == with_step).any()):
            raise OptionError(
                f"the thickness of layer {layer} does not move the focus of parallel rays: solve "
                f"for one behind the lenslets, {self.surface} to {len(self.indices) - 1}"
            )
        return _STEP_UM * without / (without - with_step)

    def focused_radius_um(self) -> Tensor:
        """Radius of curvature that brings the source to focus on the sensor.

        The element of the matrix that must vanish is linear in the curvature 1/R.

        Returns
        -------
        Tensor
            float64; the radius here does not matter.
        """
        convex, concave = (
            replace(self, radius_um=radius_um)._error() for radius_um in (_STEP_UM, -_STEP_UM)
        )
        return _STEP_UM * (concave - convex) / (concave + convex)

    def spherical_um(self, layer: int, height_um: Number) -> Tensor:
        r"""By how much a layer must be thinner for rays off a lenslet's middle, to third order.

        Rays parallel to the axis that meet a sphere at the height h, under the angle
        :math:`a = h/R`, leave it as if from the focus :math:`f' (1 - a^2 / 2m^2)` with
        :math:`m = n/n_0`, and with :math:`p = a (n - n_0)` go the way
        :math:`t p (1 + p^2 / 2n_j^2) / n_j` aside in each layer (expanded from Snell's law;
        compare `welford1986`). What paraxial rays leave out is of this size.

        Parameters
        ----------
        layer
            Number of the layer.
        height_um
            Of the rays, from the lenslet's middle.

        Returns
        -------
        Tensor
            float64, the paraxial thickness minus that for these rays, of a stack that is in focus
            for a source far away.
        """
        entered, own = self.indices[self.surface], self.indices[layer]
        angle = torch.as_tensor(height_um / self.radius_um, dtype=torch.float64)
        squared = (angle * (entered - self.before)) ** 2
        shorter = self.focal_length_um * (angle * self.before / entered) ** 2 / 2
        for number in range(self.surface + 1, len(self.indices)):
            index = self.indices[number]
            reduced = self.thicknesses_um[number] / index
            shorter = shorter + reduced * squared / 2 * (1 / index**2 - 1 / entered**2)
        return own * shorter

    def _error(self) -> Tensor:
        return self.matrix()[..., 0, 0 if math.isinf(self.source_um) else 1]

    def _from_source(self, matrix: Tensor) -> Tensor:
        if math.isinf(self.source_um):
            return matrix
        return through([translation(self.source_um), matrix])
