"""From a master film over a sensor to a replica on it: radius, thickness, and how sharp."""

import math
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from nolens.camera import MATERIALS
from nolens.design.focus import (
    LensletStack,
    depth_of_focus_um,
    lenslet_aperture,
    line_width_um,
    sharp_blur,
)
from nolens.errors import OptionError
from nolens.optics import Number

SHARP_LINE_RATIO = 1.1
"""Lines that are wider by this factor than in focus end the range of thickness called sharp."""
_NO_LENS = 1e-6


@dataclass(frozen=True)
class Cover:
    """What lies between mask and sensor: cover glass and gap, or anything; none is fine.

    Parameters
    ----------
    thicknesses_um, indices
        Of the layers, in light's order.
    """

    thicknesses_um: tuple[Number, ...]
    indices: tuple[Number, ...]

    @property
    def reduced_um(self) -> Number:
        """Σ t/n."""
        pairs = zip(self.thicknesses_um, self.indices, strict=True)
        return sum(thickness / index for thickness, index in pairs)


@dataclass(frozen=True)
class Film:
    """A master film in air over the cover.

    Parameters
    ----------
    thickness_um, index
        Of the film.
    distance_um
        From its back to the cover, where the PSF is sharpest.
    side
        Where its relief faces: "scene", as in the paper, or "sensor".
    """

    thickness_um: Number
    index: Number
    distance_um: Number
    side: Literal["scene", "sensor"]

    def over(self, cover: Cover, radius_um: Number, source_um: float) -> LensletStack:
        """The film in its place (`uvimprint`, eq. 1)."""
        return LensletStack(
            (self.thickness_um, self.distance_um, *cover.thicknesses_um),
            (self.index, 1.0, *cover.indices),
            0 if self.side == "scene" else 1,
            radius_um,
            source_um,
        )


@dataclass(frozen=True)
class Replica:
    """A layer on the cover whose lenslets face the scene, in focus for a point source.

    Parameters
    ----------
    index
        Of the layer.
    radius_um
        Of its lenslets.
    cover
        What it lies on.
    source_um
        Distance of the point source.
    """

    index: Number
    radius_um: Number
    cover: Cover
    source_um: float = math.inf

    def stack(self, thickness_um: Number) -> LensletStack:
        """The layer with a thickness, on the cover (`uvimprint`, eq. 4)."""
        return LensletStack(
            (thickness_um, *self.cover.thicknesses_um),
            (self.index, *self.cover.indices),
            0,
            self.radius_um,
            self.source_um,
        )

    @property
    def thickness_um(self) -> Tensor:
        """Thickness in focus (`uvimprint`, eq. 5); zero or less where none is."""
        return self.stack(0.0).focused_thickness_um(0)

    def check(self, name: str, wavelength_nm: float) -> None:
        """Refuse a layer that cannot focus, and say what could.

        Parameters
        ----------
        name
            Of its material.
        wavelength_nm
            Of the light, for which other materials are named.

        Raises
        ------
        OptionError
            If no thickness brings the point source to focus on the sensor.
        """
        index, radius, cover = (
            float(self.index),
            float(self.radius_um),
            float(self.cover.reduced_um),
        )
        if index <= 1 + _NO_LENS:
            raise OptionError(
                f"{name} has the index of the air in front of it, {index:g}, so its lenslets bend "
                "no light: give a material of a higher one"
            )
        focal = radius / (index - 1)
        if focal >= self.source_um:
            raise OptionError(
                f"light from {_mm(self.source_um)} never comes to focus behind lenslets of a focal "
                f"length of {_mm(focal)}: give a --distance that is several times as long"
            )
        if float(self.thickness_um) > 0:
            return
        vergence = 1 / cover + 1 / self.source_um
        highest = 1 + radius * vergence
        others = [
            each.name
            for each in MATERIALS.values()
            if each.range_nm[0] <= wavelength_nm <= each.range_nm[1]
            and 1 + _NO_LENS < each.index(wavelength_nm) < highest
        ]
        raise OptionError(
            f"{name} (n {index:.4g}) cannot focus on this sensor: with a radius of {_mm(radius)} "
            f"the focus lies {_mm(float(self._focus_um))} behind the lenslets, as in air, and the "
            f"layers over the sensor alone are as long as {_mm(cover)}. What would: a radius of "
            f"more than {_mm((index - 1) / vergence)} with {name}; a material with n below "
            f"{highest:.3f} ({', '.join(others) or 'none that nolens knows'}); or a thinner glass "
            "and gap"
        )

    @property
    def _focus_um(self) -> Number:
        """Reduced length from the lenslets to the focus."""
        return 1 / ((self.index - 1) / self.radius_um - 1 / self.source_um)

    def figures(
        self, wavelength_um: Number, pitch_um: Number, rounding: Number
    ) -> dict[str, Tensor]:
        r"""What the layer is like in focus, all lengths in um.

        Parameters
        ----------
        wavelength_um
            Of the light.
        pitch_um
            Of the lenslets.
        rounding
            Of the valleys between them, see `line_width_um`.

        Returns
        -------
        dict
            ``thickness``; ``focal_length`` as in air, :math:`R / (n' - 1)`, and
            ``focal_length_in_material``, :math:`n'` times that; ``aperture``, of the light that
            comes to focus; ``depth_of_focus`` and ``depth_of_focus_in_material``, end to end;
            ``line_width``; ``room``, by which the thickness may be off to either side until the
            lines are 10 % wider; and for a far source ``spherical``, by which the thickness is
            smaller for rays half a pitch from a lenslet's middle.
        """
        thickness = self.thickness_um
        stack = self.stack(thickness)
        focal = stack.focal_length_um
        aperture = lenslet_aperture(pitch_um, self._focus_um)
        depth = depth_of_focus_um(wavelength_um, aperture)
        blur = sharp_blur(wavelength_um, pitch_um, aperture, rounding, SHARP_LINE_RATIO)
        figures: dict[str, Number] = {
            "thickness": thickness,
            "focal_length": focal,
            "focal_length_in_material": self.index * focal,
            "aperture": aperture,
            "depth_of_focus": depth,
            "depth_of_focus_in_material": self.index * depth,
            "line_width": line_width_um(wavelength_um, pitch_um, aperture, 0.0, rounding),
            "room": self.index * blur * stack.behind_um,
        }
        if math.isinf(self.source_um):
            figures["spherical"] = stack.spherical_um(0, pitch_um / 2)
        return {
            name: torch.as_tensor(value, dtype=torch.float64) for name, value in figures.items()
        }

    def width_um(
        self, thickness_um: Number, wavelength_um: Number, pitch_um: Number, rounding: Number
    ) -> Tensor:
        """Width of the lines behind a layer of any thickness (`line_width_um`)."""
        stack = self.stack(thickness_um)
        aperture = lenslet_aperture(pitch_um, self._focus_um)
        return line_width_um(wavelength_um, pitch_um, aperture, stack.blur, rounding)


def master_radius_um(
    film_um: Number,
    film_index: Number,
    distance_um: Number,
    glass_um: Number,
    glass_index: Number,
    gap_um: Number,
) -> Number:
    r"""Radius of curvature of a master film from where it is sharpest, exactly.

    With :math:`n_0 = 1` eq. 1 gives :math:`N_{11} = 0` at

    .. math:: R = \frac{n_p - 1}{n_p}\Bigl[t_p + \frac{n_p}{n_g} t_g + n_p (d_g + d_p)\Bigr].

    Parameters
    ----------
    film_um, film_index
        Thickness :math:`t_p` and index :math:`n_p` of the film, whose relief faces the scene.
    distance_um
        :math:`d_p`, from the film to the cover glass.
    glass_um, glass_index
        Of the cover glass, :math:`t_g` and :math:`n_g`.
    gap_um
        :math:`d_g`, from the glass to the sensor.
    """
    glass = film_index / glass_index * glass_um
    air = film_index * (gap_um + distance_um)
    return (film_index - 1) / film_index * (film_um + glass + air)


def printed_radius_um(
    film_um: Number, film_index: Number, distance_um: Number, glass_um: Number, gap_um: Number
) -> Number:
    r"""Radius of curvature by eq. 3 as it is printed (`uvimprint`): the glass lacks its factor.

    :math:`R = \frac{n_p - 1}{n_p}[t_p + t_g + n_p (d_g + d_p)]`; see `master_radius_um`, which is
    right.
    """
    air = film_index * (gap_um + distance_um)
    return (film_index - 1) / film_index * (film_um + glass_um + air)


def replica_thickness_um(
    radius_um: Number, index: Number, glass_um: Number, glass_index: Number, gap_um: Number
) -> Number:
    r"""Thickness of a replica on the cover glass (`uvimprint`, eq. 5).

    .. math:: t' = n' \Bigl[\frac{R}{n' - 1} - \frac{t_g}{n_g} - d_g\Bigr]

    Parameters
    ----------
    radius_um
        R, of its lenslets, which face the scene.
    index
        :math:`n'`, of the replica.
    glass_um, glass_index, gap_um
        As for `master_radius_um`.
    """
    return index * (radius_um / (index - 1) - glass_um / glass_index - gap_um)


def _mm(length_um: float) -> str:
    return f"{length_um * 1e-3:.3g} mm"
