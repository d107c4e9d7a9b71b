"""How much contrast a PSF carries at a spatial frequency, and how much of it is dark."""

import math

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import rfft2

_RING_STEPS = 3.0


def spectral_magnitude(pattern: Tensor, cell_um: float, per_mm: float) -> float:
    r"""Spectral magnitude of one square millimetre of a PSF at a spatial frequency.

    :math:`\sqrt{a\,\langle|\hat p_f|^2\rangle}\,/\,\hat p_0` over a ring of frequencies, with a the
    PSF's area in mm². A PSF of random spots carries contrast in proportion to
    :math:`1/\sqrt a`; for the area of one mm² it is the same whatever part is looked at. It is no
    modulation transfer, which is 1 at zero frequency: a mask with four times as many spots to the
    mm² has half of it.

    Parameters
    ----------
    pattern
        (rows, columns), in any unit; its mean is taken off before it is transformed.
    cell_um
        Pitch of its pixels.
    per_mm
        The frequency.

    Raises
    ------
    DataError
        If the PSF is dark, or too small or too coarse for the frequency.
    """
    rows, columns = pattern.shape
    mean = float(pattern.double().mean())
    if not mean > 0:
        raise DataError("the PSF is dark: it has no contrast to measure")
    spectrum = rfft2((pattern - mean).contiguous())
    along = torch.fft.fftfreq(rows, cell_um * 1e-3, dtype=torch.float64)
    across = torch.fft.rfftfreq(columns, cell_um * 1e-3, dtype=torch.float64)
    radius = torch.hypot(along[:, None].expand(-1, len(across)), across.expand(len(along), -1))
    half_width = _RING_STEPS * 1e3 / (cell_um * min(rows, columns))
    ring = ((radius - per_mm).abs() < half_width) & (radius > 0)
    if per_mm > 5e2 / cell_um or not ring.any():
        raise DataError(
            f"{per_mm:g} lines per mm cannot be measured on {rows}×{columns} pixels of {cell_um:g} "
            f"um: choose up to {5e2 / cell_um:.0f}, or a larger PSF"
        )
    power = float(spectrum.abs().double().square()[ring].mean())
    area_mm2 = rows * columns * (cell_um * 1e-3) ** 2
    return math.sqrt(area_mm2 * power) / (rows * columns * mean)


def sparsity(pattern: Tensor, noise: float = 0.0) -> float:
    r"""Fraction of the area without light, :math:`1 - (Σp)^2 / (N Σp^2)`: 0 for an even PSF.

    Parameters
    ----------
    pattern
        Of any shape, in any unit.
    noise
        Standard deviation of the noise in it, whose square is taken off the mean of p².

    Raises
    ------
    DataError
        If it is dark.
    """
    values = pattern.double()
    squared = float(values.square().mean()) - noise**2
    if not squared > 0:
        raise DataError("the PSF is dark: it has no light to measure")
    return 1 - float(values.mean()) ** 2 / squared
