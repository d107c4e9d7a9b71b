"""How fine a detail a point spread function carries."""

import torch
from torch import Tensor

from nolens.kernels import rfft2

_FAINTEST = 1e-2
"""Transfer, as a fraction of the strongest, below which detail drowns in a measurement's noise."""
_NOISE_AT_MOST = 0.1
"""Fraction of the strongest transfer up to which what is left everywhere counts as noise."""
_CLEAR = 2.0
"""How far above that a transfer must be."""
_RINGS = 100
_LEAST_CELLS = 16
_HIGHEST = 0.5


def finest_detail(psf: Tensor) -> float:
    r"""Highest spatial frequency that a PSF carries, in cycles per pixel; 0.5 at most.

    A frequency is carried where the transfer, the root of the mean power in its ring under Hann's
    window, is at least 1 % of the strongest ring's, and twice what is left in the weakest, if
    that is below 10 % of the strongest and so may be noise. Squares of b×b pixels still hold what
    is carried where :math:`b < 1/(2f)`.

    Parameters
    ----------
    psf
        (channels, rows, columns); the channel that carries most counts.
    """
    rows, columns = psf.shape[-2:]
    if min(rows, columns) < _LEAST_CELLS:
        return _HIGHEST
    window = torch.outer(
        torch.hann_window(rows, periodic=False), torch.hann_window(columns, periodic=False)
    )
    rings = min(_RINGS, min(rows, columns) // 4)
    down = torch.fft.fftfreq(rows)[:, None]
    right = torch.fft.rfftfreq(columns)
    ring = (torch.hypot(down, right) * (rings / _HIGHEST)).int().clamp_(max=rings).flatten()
    count = torch.bincount(ring, minlength=rings + 1)[:rings]
    finest = 0.0
    for plane in psf.cpu().float():
        mean = (plane * window).sum() / window.sum()
        power = rfft2((plane - mean) * window).abs().square_().flatten()
        transfer = (torch.bincount(ring, power, rings + 1)[:rings] / count).sqrt()
        strongest, weakest = float(transfer.max()), float(transfer.min())
        least = _FAINTEST * strongest
        if weakest < _NOISE_AT_MOST * strongest:
            least = max(least, _CLEAR * weakest)
        last = int((transfer >= least).nonzero()[-1])
        finest = max(finest, (last + 1) / rings * _HIGHEST)
        if finest >= _HIGHEST:
            break
    return finest
