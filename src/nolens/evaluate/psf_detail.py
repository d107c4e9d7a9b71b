"""How fine a detail a point spread function carries."""

import torch
from torch import Tensor

from nolens.evaluate.psf_figures_spectrum import Spectrum

_FAINTEST = 1e-2
"""Transfer, as a share of the strongest, below which detail drowns in a measurement's noise."""
_NOISE_AT_MOST = 0.1
"""Share of the strongest transfer up to which what is left everywhere counts as noise."""
_CLEAR = 2.0
"""How far above that a transfer must be."""
_LARGEST = 8


def carried_cells(psf: Tensor) -> int:
    r"""Side of the largest square of cells that may be made one without losing carried detail.

    A frequency f is carried where the transfer T(f), the root of the power in its ring under
    Hann's window, is at least 1 % of the strongest, and twice what is left at the weakest ring,
    if that is below 10 % of the strongest and so may be noise. Cells of b×b hold
    :math:`f < 1/(2b)`; b is the largest whose limit is above all that is carried, 8 at most.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    """
    rows, columns = psf.shape[-2:]
    if min(rows, columns) < 2 * _LARGEST:
        return 1
    window = (
        torch.hann_window(rows, periodic=False)[:, None]
        * torch.hann_window(columns, periodic=False)
    ).to(psf)
    finest = 0.0
    for plane in psf:
        mean = (plane * window).sum() / window.sum()
        at, transfer = Spectrum.of((plane - mean) * window, 0.0).transfer()
        strongest, weakest = float(transfer.max()), float(transfer.min())
        least = _FAINTEST * strongest
        if weakest < _NOISE_AT_MOST * strongest:
            least = max(least, _CLEAR * weakest)
        finest = max(finest, float(at[transfer >= least].max()))
    return max(1, min(_LARGEST, int(0.5 / max(finest, 1e-3))))
