"""How much resin to pour into the frame, and how much to mix for the mould."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from nolens.camera import Camera, material
from nolens.errors import OptionError
from nolens.fabricate.frame import FrameGeometry, poured_layer

_WATER_G_CM3 = 1.0
_MARGIN_MM = 10.0
_GRAVITY_M_S2 = 9.80665
_TERMS = 20_000
_LARGEST_EXPONENT = 700.0


@dataclass(frozen=True)
class Wetting:
    """Surface tension γ of a liquid, and the contact angle at which it runs over a wall's top."""

    surface_tension_n_m: float = 0.035
    contact_angle_deg: float = 30.0
    source: str = (
        "placeholder: a surface tension and a contact angle as usual for liquid acrylate resins "
        "on a printed wall, until a measurement replaces them"
    )

    def capillary_length_mm(self, density_g_cm3: float) -> float:
        r"""Length :math:`ℓ = \sqrt{γ/(ρg)}` over which a surface bends (`degennes2004`)."""
        weight = density_g_cm3 * 1e3 * _GRAVITY_M_S2
        return 1e3 * math.sqrt(self.surface_tension_n_m / weight)


@dataclass(frozen=True)
class ResinAmount:
    """Resin for one camera.

    Parameters
    ----------
    cavity_mm3
        Volume that the cured layer fills, package and rim left out.
    shrinkage
        Fraction of its volume that the liquid loses while it cures.
    meniscus_mm3
        Liquid that stands above the frame's top, so that the mould meets its middle first.
    pour_mm3
        Liquid to pour.
    mass_mg
        Its mass; None where the material's density is not known.
    density_g_cm3
        Of the cured material.
    overflow_mm3
        Cured resin over the rim and in the vents.
    notes
        What is not known, in sentences.
    """

    cavity_mm3: float
    shrinkage: float
    meniscus_mm3: float
    pour_mm3: float
    mass_mg: float | None
    density_g_cm3: float | None
    overflow_mm3: float = 0.0
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        camera: Camera,
        frame: FrameGeometry,
        *,
        crown_mm: float = 0.1,
        wetting: Wetting | None = None,
    ) -> Self:
        r"""Work out how much to pour.

        What is cured must fill the cavity, the space over the rim and the vents, and the liquid
        was larger by the shrinkage s; it also stands above the edge, as `meniscus_mm3` says:

        .. math:: V = \frac{V_{cavity} + V_{rim} + V_{vents}}{1 - s} + V_{meniscus}, \qquad
                  m = V (1 - s) ρ

        with the density ρ after curing, because curing does not change the mass.

        Parameters
        ----------
        camera
            Its poured layer's material has density and shrinkage.
        frame
            The frame that is poured into.
        crown_mm
            Height of the liquid's middle above the frame's top, before the mould is laid on.
        wetting
            Of the resin; None takes usual figures.

        Raises
        ------
        OptionError
            If the liquid would run over the wall's top.
        """
        made_of = camera.material_of(poured_layer(camera))
        density = None if made_of is None else made_of.density_g_cm3
        shrinkage = None if made_of is None else made_of.cure_shrinkage
        name = "the resin, of which only the index is given," if made_of is None else made_of.name
        notes = []
        if density is None:
            notes.append(
                f"the density of {name} is not known: the amount is given as a volume only; for "
                "its mass, describe the resin in TOML with density_g_cm3"
            )
        if shrinkage is None:
            notes.append(
                f"the shrinkage of {name} is not known, and is taken as none: describe the resin "
                "in TOML with cure_shrinkage_percent"
            )
        lost = shrinkage or 0.0
        liquid_g_cm3 = (1 - lost) * (density or _WATER_G_CM3)
        meniscus = meniscus_mm3(frame, crown_mm, wetting or Wetting(), liquid_g_cm3)
        overflow = frame.rim_mm3 + frame.vents_mm3
        pour = (frame.cavity_mm3 + overflow) / (1 - lost) + meniscus
        return cls(
            cavity_mm3=frame.cavity_mm3,
            shrinkage=lost,
            meniscus_mm3=meniscus,
            pour_mm3=pour,
            mass_mg=None if density is None else pour * liquid_g_cm3,
            density_g_cm3=density,
            overflow_mm3=overflow,
            notes=tuple(notes),
        )

    @property
    def cavity_mg(self) -> float | None:
        """Mass of the cured layer in the cavity alone."""
        return None if self.density_g_cm3 is None else self.cavity_mm3 * self.density_g_cm3


@dataclass(frozen=True)
class MouldAmount:
    """PDMS for the mould: a slab as large as the dish it is cast in.

    Parameters
    ----------
    dish_mm
        (width, height) of the dish.
    thickness_mm
        Of the slab.
    ratio
        Mass of the base for one of the hardener.
    density_g_cm3
        Of the mixture, taken as that of the cured material.
    """

    dish_mm: tuple[float, float]
    thickness_mm: float
    ratio: float
    density_g_cm3: float

    @classmethod
    def of(
        cls,
        frame: FrameGeometry,
        *,
        dish_mm: tuple[float, float] | None = None,
        thickness_mm: float = 5.0,
        ratio: float = 6.0,
    ) -> Self:
        """Work out how much to mix.

        A dish of None is 10 mm larger than the frame on every side, as the mould lies on that.
        The paper's ratio of base to hardener is 6:1 by mass (`uvimprint`).

        Raises
        ------
        OptionError
            If the mould would not cover the frame, or has no thickness.
        """
        outer = frame.outer_width_mm, frame.outer_height_mm
        if dish_mm is None:
            dish_mm = outer[0] + 2 * _MARGIN_MM, outer[1] + 2 * _MARGIN_MM
        if any(
            not side < inside for side, inside in zip(sorted(outer), sorted(dish_mm), strict=True)
        ):
            raise OptionError(
                f"a mould from a dish of {dish_mm[0]:g} × {dish_mm[1]:g} mm does not cover the "
                f"frame of {outer[0]:.5g} × {outer[1]:.5g} mm: give a larger dish (--dish)"
            )
        if not 0 < thickness_mm < math.inf or not 0 < ratio < math.inf:
            raise OptionError(
                f"a mould {thickness_mm:g} mm thick (--mould-thickness) of {ratio:g}:1: both must "
                "be more than 0"
            )
        density = material("pdms").density_g_cm3
        assert density is not None
        return cls(dish_mm, thickness_mm, ratio, density)

    @property
    def volume_mm3(self) -> float:
        """Volume of the slab."""
        return self.dish_mm[0] * self.dish_mm[1] * self.thickness_mm

    @property
    def mass_g(self) -> float:
        """Mass of the slab."""
        return self.volume_mm3 * self.density_g_cm3 * 1e-3

    @property
    def base_g(self) -> float:
        """Mass of the base."""
        return self.mass_g * self.ratio / (self.ratio + 1)

    @property
    def hardener_g(self) -> float:
        """Mass of the hardener."""
        return self.mass_g / (self.ratio + 1)


def meniscus_mm3(
    frame: FrameGeometry, crown_mm: float, wetting: Wetting, density_g_cm3: float
) -> float:
    r"""Volume of liquid that stands above the frame's top, held at the rim's upper edge.

    For small slopes its surface z follows the Young–Laplace equation
    :math:`ℓ^2 ∇^2 z = z - z_0` with z = 0 along the edge (`degennes2004`). Over a rectangle of
    width w and height 2b its solution is, with the odd numbers m, :math:`k = mπ/w` and
    :math:`q^2 = k^2 + 1/ℓ^2`,

    .. math:: z(x, y) = z_0 \sum_m \frac{4}{π m} \frac{1}{1 + ℓ^2 k^2}
              \left(1 - \frac{\cosh q y}{\cosh q b}\right) \sin k x,

    and z_0 is such that the middle is as high as the crown. The edge holds it while its slope is
    less than that of the contact angle.

    Raises
    ------
    OptionError
        If the crown is negative, or its slope at the edge is more than the contact angle's.
    """
    if not 0 <= crown_mm < math.inf:
        raise OptionError(f"a crown of {crown_mm:g} mm (--crown): give 0 mm or more")
    if crown_mm == 0:
        return 0.0
    length = wetting.capillary_length_mm(density_g_cm3)
    width = frame.inner_width_mm + 2 * frame.rim_mm
    height = frame.inner_height_mm + 2 * frame.rim_mm
    crowns = _unit_crown(width, height, length), _unit_crown(height, width, length)
    steepest = max(crown.steepest_per_mm for crown in crowns)
    most = math.tan(math.radians(wetting.contact_angle_deg)) / steepest
    if crown_mm > most:
        raise OptionError(
            f"a crown of {crown_mm:g} mm runs over the wall's top, which the resin wets at "
            f"{wetting.contact_angle_deg:g} deg: give at most {math.floor(1e3 * most) / 1e3:g} mm "
            "(--crown)"
        )
    return crown_mm * width * height * crowns[0].mean


@dataclass(frozen=True)
class _Crown:
    """A crown 1 high over a rectangle: its mean height, and its slope where that is largest."""

    mean: float
    steepest_per_mm: float


def _unit_crown(width: float, height: float, length: float) -> _Crown:
    """The steepest place is taken among the middles of the two edges along the width."""
    m = np.arange(1, 2 * _TERMS, 2)
    k = m * (np.pi / width)
    q = np.sqrt(k * k + length**-2)
    b = height / 2
    weights = 4 / (np.pi * m) / (1 + (length * k) ** 2)
    in_middle = weights * np.where(m % 4 == 1, 1, -1)
    middle = np.sum(in_middle * (1 - 1 / np.cosh(np.minimum(q * b, _LARGEST_EXPONENT))))
    mean = np.sum(weights * (1 - np.tanh(q * b) / (q * b)) * 2 / (np.pi * m))
    slope = np.sum(in_middle * q * np.tanh(q * b))
    return _Crown(float(mean / middle), float(slope / middle))
