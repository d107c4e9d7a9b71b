"""Figures of a point spread function, measured as the paper measures its own."""

from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2


@dataclass(frozen=True)
class PatternFigures:
    """What the autocorrelation of a PSF shows.

    Parameters
    ----------
    width_um
        Full width at half maximum of the autocorrelation. A line of the PSF with a Gaussian
        profile is √2 thinner.
    pitch_um
        From its first peak, at zero, to the second: the mean distance of neighbouring lines.
    """

    width_um: float
    pitch_um: float


def pattern_figures(psf: Tensor, cell_um: float) -> PatternFigures:
    r"""Width and pitch of a PSF from its autocorrelation (`uvimprint`, fig. 5b).

    The mean is subtracted; the autocorrelation :math:`F^{-1}|F(p - \bar p)|^2` of the whole
    frame is averaged over all directions, where the paper draws one line through it. The second
    peak is the highest after the first minimum, refined by a parabola.

    Parameters
    ----------
    psf
        (height, width), in any unit.
    cell_um
        Pitch of its pixels.

    Raises
    ------
    DataError
        If the PSF is even, or too small to have a second peak.
    """
    rows, columns = psf.shape
    spectrum = rfft2((psf - psf.double().mean().to(psf.dtype)).contiguous())
    correlation = irfft2(spectrum.abs().square().to(spectrum.dtype), (rows, columns))
    if not float(correlation[0, 0]) > 0:
        raise DataError("the PSF is even: it has no lines to measure")
    profile = _radial(correlation)
    below = (profile < 0.5).nonzero()
    if len(below) == 0:
        raise DataError("the PSF is too small to measure: its lines are wider than half of it")
    first = int(below[0])
    before, after = float(profile[first - 1]), float(profile[first])
    half = first - 1 + (before - 0.5) / (before - after)
    valley = _first_valley(profile, first)
    # Farther neighbours can make a higher peak: the first one of at least half the height counts.
    rest = profile[valley:]
    high = rest >= (rest.min() + rest.max()) / 2
    start = int(high.nonzero()[0])
    ends = (~high[start:]).nonzero()
    length = int(ends[0]) if len(ends) else len(rest) - start
    peak = valley + start + int(rest[start : start + length].argmax())
    if not valley < peak < len(profile) - 1:
        raise DataError("the PSF is too small to measure: its autocorrelation has no second peak")
    left, top, right = (float(profile[peak + step]) for step in (-1, 0, 1))
    peak_at = peak + (left - right) / (2 * (left - 2 * top + right))
    return PatternFigures(width_um=2 * half * cell_um, pitch_um=peak_at * cell_um)


def _radial(correlation: Tensor) -> Tensor:
    """Mean over all directions by distance in cells, up to a quarter of the frame; 1 at zero."""
    reach = min(correlation.shape) // 4
    lags = [torch.fft.fftfreq(n, 1 / n, dtype=torch.float64) for n in correlation.shape]
    near = [(lag.abs() <= reach + 1).nonzero().flatten() for lag in lags]
    distance = torch.hypot(
        lags[0][near[0]][:, None].expand(-1, len(near[1])),
        lags[1][near[1]].expand(len(near[0]), -1),
    ).flatten()
    values = correlation[near[0]][:, near[1]].double().flatten()
    # Every value counts in the two rings it lies between, by its distance to them.
    inner = distance.floor().long()
    share = distance - inner
    length = int(inner.max()) + 2
    total, weight = torch.zeros(length).double(), torch.zeros(length).double()
    for ring, part in ((inner, 1 - share), (inner + 1, share)):
        total.index_add_(0, ring, values * part)
        weight.index_add_(0, ring, part)
    profile = (total / weight.clamp_min(1e-12))[: reach + 1]
    return profile / profile[0]


def _first_valley(profile: Tensor, start: int) -> int:
    """The first place from `start` on after which the profile rises."""
    rising = (profile[start + 1 :] > profile[start:-1]).nonzero()
    return start + int(rising[0]) if len(rising) else len(profile) - 1
