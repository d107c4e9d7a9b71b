"""What a lenslet's focus is like: aperture, depth, and the width of the PSF's lines."""

import math

import torch
from torch import Tensor

from nolens.optics import Number

_ROUNDED = 1.5
_FILLED = 0.4


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
    wavelength_um: Number, pitch_um: Number, aperture: Number, rounding: Number, wider: float
) -> Number:
    r"""Blur at which the lines are wider than in focus by a factor (inverse of `line_width_um`).

    Parameters
    ----------
    wavelength_um, pitch_um, aperture, rounding
        As for `line_width_um`.
    wider
        The factor, above 1.
    """
    diffraction = wavelength_um / (2 * aperture) * (1 + _ROUNDED * rounding)
    return math.sqrt(wider**2 - 1) * diffraction / (_FILLED * pitch_um)
