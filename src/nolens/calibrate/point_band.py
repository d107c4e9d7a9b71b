"""Up to which spatial frequency a PSF stands out of its noise."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import rfft2

_RINGS = 64
_LEAST_FREQUENCIES = 12


@dataclass(frozen=True)
class Band:
    """Spectrum of a PSF beside that of its noise.

    Parameters
    ----------
    per_mm
        Spatial frequency of each ring.
    signal, noise
        Mean power in it; the signal's is what the picture has more than its noise.
    usable_per_mm
        Frequency up to which the signal's is the larger one; zero if nowhere.
    """

    per_mm: tuple[float, ...]
    signal: tuple[float, ...]
    noise: tuple[float, ...]
    usable_per_mm: float


def usable_band(
    picture: Tensor, cell_um: float, *, variance: Tensor, noise: Tensor | None = None
) -> Band:
    r"""Compare the radial power spectra of a PSF and of its noise.

    Both are tapered by Hann's window, without which the edges of a PSF that fills the sensor
    would pass for fine structure. White noise of the variance v(x) has the power
    :math:`Σ v\,w^2` at every frequency.

    Parameters
    ----------
    picture
        (rows, columns), with noise.
    cell_um
        Pitch of its pixels.
    variance
        Of the noise, of the same shape.
    noise
        A picture of noise alone, as strong as that in the picture; None takes the variance.

    Returns
    -------
    Band
        In rings from the mean up to the finest frequency of the pixels.
    """
    rows, columns = picture.shape
    window = (
        torch.hann_window(rows, periodic=False)[:, None]
        * torch.hann_window(columns, periodic=False)
    ).to(picture.dtype)
    mean = (picture * window).sum() / window.sum()
    total = _power((picture - mean) * window)
    if noise is None:
        floor = torch.full_like(total, float((variance * window.square()).double().sum()))
    else:
        floor = _power(noise * window)
    along = torch.fft.fftfreq(rows, cell_um * 1e-3, dtype=torch.float64)
    across = torch.fft.rfftfreq(columns, cell_um * 1e-3, dtype=torch.float64)
    radius = torch.hypot(along[:, None].expand(-1, len(across)), across.expand(len(along), -1))
    finest = 5e2 / cell_um
    rings = min(_RINGS, min(rows, columns) // 4)
    ring = (radius / finest * rings).long().flatten()
    kept = ring < rings
    number = torch.bincount(ring[kept], minlength=rings).double()
    means = [
        torch.bincount(ring[kept], each.flatten()[kept], minlength=rings) / number.clamp_min(1)
        for each in (total, floor)
    ]
    enough = number >= _LEAST_FREQUENCIES
    centres = (torch.arange(rings) + 0.5) / rings * finest
    signal = (means[0] - means[1]).clamp_min(0)
    drowned = ((signal < means[1]) & enough).nonzero()
    last = rings if len(drowned) == 0 else int(drowned[0])
    return Band(
        tuple(centres.tolist()),
        tuple(signal.tolist()),
        tuple(means[1].tolist()),
        last / rings * finest,
    )


def _power(picture: Tensor) -> Tensor:
    return rfft2(picture.float().contiguous()).abs().double().square()
