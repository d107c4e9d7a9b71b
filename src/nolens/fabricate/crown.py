"""How the resin stands above the frame before the mould is laid on."""

import math
from dataclasses import dataclass

import numpy as np

from nolens.errors import OptionError
from nolens.fabricate.frame import FrameGeometry

_GRAVITY_M_S2 = 9.80665
_TERMS = 20_000
_LARGEST_EXPONENT = 700.0


@dataclass(frozen=True)
class Wetting:
    r"""How a liquid stands at an edge.

    Parameters
    ----------
    surface_tension_n_m
        γ, in N/m.
    contact_angle_deg
        At which it runs on over the top of the wall.
    source
        Where the figures come from.
    """

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
class _Crown:
    """A crown 1 high over a rectangle: its mean height, and its slope where that is largest."""

    mean: float
    steepest_per_mm: float


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

    Parameters
    ----------
    frame
        The liquid ends at its rim's upper edge.
    crown_mm
        Height of the middle.
    wetting
        Of the liquid.
    density_g_cm3
        Of the liquid.

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
    crowns = _crown(width, height, length), _crown(height, width, length)
    steepest = max(crown.steepest_per_mm for crown in crowns)
    most = math.tan(math.radians(wetting.contact_angle_deg)) / steepest
    if crown_mm > most:
        raise OptionError(
            f"a crown of {crown_mm:g} mm runs over the wall's top, which the resin wets at "
            f"{wetting.contact_angle_deg:g} deg: give at most {math.floor(1e3 * most) / 1e3:g} mm "
            "(--crown)"
        )
    return crown_mm * width * height * crowns[0].mean


def _crown(width: float, height: float, length: float) -> _Crown:
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
