"""Where lenslets over a sensor focus, and how sharply: ray matrices, depth, width of lines."""

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from nolens.amounts import rounded
from nolens.errors import OptionError
from nolens.optics import Number, through, through_layers, translation
from nolens.twin import REFERENCE_NM

_STEP_UM = 1000.0
_ROUNDED = 1.5
_FILLED = 0.4


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


def lenslet_aperture(pitch_um: Number, focal_length_um: Number) -> Number:
    r"""Numerical aperture of a lenslet, :math:`\text{NA} = p / 2f` (`uvimprint`).

    Parameters
    ----------
    pitch_um
        Distance p of neighbouring lenslets.
    focal_length_um
        Focal length f as in air, or for a near source the distance of its focus as in air: in a
        denser medium the rays are flatter by its index, and n sin θ is the same.
    """
    return pitch_um / (2 * focal_length_um)


def depth_of_focus_um(wavelength_um: Number, aperture: Number) -> Number:
    r"""Depth of focus :math:`λ / \text{NA}^2` in air, from end to end (`uvimprint`).

    In a medium it is longer by its index. The paper's 0.41 mm are those of NA 0.035 at 500 nm. At
    its ends `line_width_um` has grown by 19 % where valleys are rounded as in the preset of the
    paper, by 28 % where they are sharp.

    Parameters
    ----------
    wavelength_um
        In vacuum.
    aperture
        See `lenslet_aperture`.
    """
    return wavelength_um / aperture**2


def line_width_um(
    wavelength_um: Number, pitch_um: Number, aperture: Number, blur: Number, rounding: Number = 0.0
) -> Tensor:
    r"""Width at half maximum of the lines of the PSF that random lenslets cast.

    Diffraction of a lenslet and the width of its pencil out of focus, added in squares:

    .. math:: w^2 = \Bigl[\frac{λ}{2\,\text{NA}} (1 + 1.5 s)\Bigr]^2 + (0.4\,p\,ε)^2

    The factors 1.5 and 0.4 are fitted to the twin's PSFs, measured as the paper measures its
    own (`nolens.evaluate.pattern_figures`, width of the autocorrelation over √2), for 450 to
    650 nm, pitches of 70 and 100 um and radii of 0.5 and 0.67 mm. The model holds to 15 % for
    :math:`|ε| \le 0.1` and to 25 % for :math:`|ε| \le 0.4`, for s from 0.1 to 0.16; sharper valleys
    make lines up to 30 % narrower than it says. For the preset of the paper it gives 14.1 um at
    550 nm, the twin 13.8 um, the prototype 14.25 um.

    Parameters
    ----------
    wavelength_um
        λ in vacuum.
    pitch_um
        p, of the lenslets.
    aperture
        NA of a lenslet, see `lenslet_aperture`.
    blur
        ε, see `LensletStack.blur`.
    rounding
        s, standard deviation of the Gaussian that rounds the valleys, over the pitch.

    Returns
    -------
    Tensor
        float64.
    """
    diffraction = wavelength_um / (2 * aperture) * (1 + _ROUNDED * rounding)
    pencil = _FILLED * pitch_um * blur
    return torch.as_tensor(diffraction**2 + pencil**2, dtype=torch.float64).sqrt()


def sharp_blur(
    wavelength_um: Number, pitch_um: Number, aperture: Number, rounding: Number, ratio: float
) -> Number:
    r"""Blur at which the lines are wider than in focus by a factor (inverse of `line_width_um`).

    Parameters
    ----------
    wavelength_um, pitch_um, aperture, rounding
        As for `line_width_um`.
    ratio
        The factor, above 1.
    """
    diffraction = wavelength_um / (2 * aperture) * (1 + _ROUNDED * rounding)
    return math.sqrt(ratio**2 - 1) * diffraction / (_FILLED * pitch_um)


def lenslet_figures(pitch_um: float | None, reduced_um: float | None) -> dict[str, Any]:
    """Aperture and depth of focus of a lenslet as wide as the pitch (`uvimprint`).

    Parameters
    ----------
    pitch_um
        Of the lenslets; None where it is not known.
    reduced_um
        Sum of thickness / index of the layers behind them; None gives no figures.
    """
    if reduced_um is None:
        return {}
    figures: dict[str, Any] = {
        "reduced_thickness_mm": round(reduced_um * 1e-3, 5),
        "one_per_mm_in_per_degree": rounded(reduced_um * 1e-3 * math.pi / 180),
        "lenslet_aperture": None,
        "depth_of_focus_mm": None,
    }
    if pitch_um is not None:
        aperture = lenslet_aperture(pitch_um, reduced_um)
        depth_um = depth_of_focus_um(REFERENCE_NM * 1e-3, aperture)
        figures["lenslet_aperture"] = rounded(float(aperture))
        figures["depth_of_focus_mm"] = rounded(float(depth_um) * 1e-3)
    return figures
