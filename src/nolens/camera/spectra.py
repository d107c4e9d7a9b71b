"""The colour of spectra: CIE's colour matching functions, and false colours on a screen."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_LOBES = (
    ((1.056, 599.8, 37.9, 31.0), (0.362, 442.0, 16.0, 26.7), (-0.065, 501.1, 20.4, 26.2)),
    ((0.821, 568.8, 46.9, 40.5), (0.286, 530.9, 16.3, 31.1)),
    ((1.217, 437.0, 11.8, 36.0), (0.681, 459.0, 26.0, 13.8)),
)
"""Height, centre, and widths below and above it, in nm."""
_SRGB = (
    (3.2404542, -1.5371385, -0.4985314),
    (-0.9692660, 1.8760108, 0.0415560),
    (0.0556434, -0.2040259, 1.0572252),
)
"""From XYZ to linear sRGB (IEC 61966-2-1)."""
_D65 = (0.95047, 1.0, 1.08883)


def colour_matching(wavelength_nm: NDArray[np.float64]) -> NDArray[np.float64]:
    """x, y and z of CIE 1931, (3, …), as `wyman2013` fit them by Gaussians."""
    out = np.zeros((3, *wavelength_nm.shape))
    for total, lobes in zip(out, _LOBES, strict=True):
        for height, centre, below, above in lobes:
            width = np.where(wavelength_nm < centre, below, above)
            total += height * np.exp(-(((wavelength_nm - centre) / width) ** 2) / 2)
    return out


def spectral_srgb(radiance: Tensor, wavelength_nm: list[float]) -> Tensor:
    """Linear sRGB of spectra, (3, height, width), in which an even spectrum is white.

    Parameters
    ----------
    radiance
        Linear, of each wavelength, (bands, height, width). Colours beyond sRGB are clipped at 0.
    wavelength_nm
        In the visible range; bands outside are dark.
    """
    seen = colour_matching(np.asarray(wavelength_nm, dtype=np.float64))
    seen *= np.array(_D65)[:, None] / np.maximum(seen.sum(axis=1, keepdims=True), 1e-12)
    matrix = torch.from_numpy(np.array(_SRGB) @ seen).to(radiance)
    mixed: Tensor = torch.tensordot(matrix, radiance, dims=1)
    return mixed.clamp_min(0)


def linear_stokes(radiance: Tensor, angle_deg: list[float]) -> Tensor:
    r"""S0, S1, S2, degree and angle (0 to 180 deg) of linear polarisation, (5, height, width).

    Of light that is the sum of `radiance`, (angles, height, width), each part polarised at its
    angle: :math:`S_1 + iS_2 = \sum_k v_k e^{2iθ_k}`.
    """
    turned = 2 * torch.tensor([math.radians(each) for each in angle_deg]).to(radiance)
    factors = torch.stack([torch.ones_like(turned), torch.cos(turned), torch.sin(turned)])
    s0, s1, s2 = torch.tensordot(factors, radiance, dims=1)
    degree = torch.hypot(s1, s2) / s0.clamp_min(1e-12)
    angle = torch.rad2deg(0.5 * torch.atan2(s2, s1)) % 180
    return torch.stack([s0, s1, s2, degree, angle])
