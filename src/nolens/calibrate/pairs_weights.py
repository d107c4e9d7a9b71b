"""How far each spatial frequency of a measurement is to be trusted."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
import torch
from torch import Tensor

from nolens.kernels import irfft2, rfft2

_MODEL_ERROR = 0.1
_FADED = 8
_BANDS = 24
_NOISE_FROM = 0.45


@dataclass(frozen=True)
class Weights:
    r"""Inverse covariance of what a measurement is off: W = T F* (1/P) F T.

    Noise is white; what the model leaves out (light that comes aslant, misregistration, light from
    beside the picture) is not: it is a small share of the light where there is much, at low
    spatial frequencies, and a large one where there is little. So P(f) = N + ε √(S(f) S₀), with
    the power S of the measurements by spatial frequency, S₀ its largest, the noise N at the
    highest frequencies, and ε a tenth: generalised least squares (`aitken1936`). Without it, ten
    low frequencies outweigh all of the pattern. T fades out towards the sensor's edges and is zero
    where a pixel is saturated.

    Attributes
    ----------
    taper
        T, (measurements, rows, columns).
    frequencies
        Mean of each band, in cycles to the cell.
    expected
        P, (measurements, bands).
    spectrum
        1/P on the half spectrum of the sensor, (measurements, rows, columns // 2 + 1).
    """

    taper: Tensor
    frequencies: Tensor
    expected: Tensor
    spectrum: Tensor

    @classmethod
    def of(cls, measured: Tensor, valid: Tensor) -> Self:
        """Find them of measurements of the same mean, (measurements, rows, columns)."""
        rows, columns = measured.shape[-2:]
        taper = torch.outer(_faded(rows), _faded(columns)) * valid
        frequency = _frequency(rows, columns)
        edges = torch.logspace(math.log10(0.75 / min(rows, columns)), math.log10(0.75), _BANDS)
        band = torch.bucketize(frequency, edges).flatten()
        filled = torch.bincount(band) > 0
        bands = (filled.cumsum(0) - 1)[band]
        count = torch.bincount(bands)
        middle = torch.bincount(bands, frequency.flatten()) / count
        spectrum = rfft2(measured * taper).abs().square()
        spectrum /= taper.square().sum(dim=(-2, -1), keepdim=True)
        power = torch.stack([torch.bincount(bands, each.flatten()) / count for each in spectrum])
        noise = power[:, middle >= _NOISE_FROM].amin(dim=1, keepdim=True)
        mean = power.mean(dim=0)
        expected = noise + _MODEL_ERROR * (mean * mean.max()).sqrt()
        return cls(taper, middle, expected, _spread(1 / expected, middle, frequency))

    def __call__(self, values: Tensor) -> Tensor:
        """Apply W to (measurements, rows, columns)."""
        spectrum = rfft2(values * self.taper) * self.spectrum
        return self.taper * irfft2(spectrum, (values.shape[-2], values.shape[-1]))

    def product(self, one: Tensor, other: Tensor) -> Tensor:
        """⟨one, W other⟩ of each measurement, (measurements, 1, 1), float64."""
        return (one.double() * self(other)).sum(dim=(-2, -1), keepdim=True)

    def on_period(self, period: tuple[int, int]) -> Tensor:
        """T² F* (1/P) F in the mean, on the half spectrum of a period that holds the sensor."""
        share = self.taper.square().sum(dim=(-2, -1), keepdim=True) / (period[0] * period[1])
        return share * _spread(1 / self.expected, self.frequencies, _frequency(*period))


def _faded(length: int) -> Tensor:
    """1, but for both ends, which rise as sin² over an eighth of the length."""
    edge = max(1, length // _FADED)
    rise = torch.sin((torch.arange(edge) + 0.5) / edge * (math.pi / 2)).square()
    return torch.cat([rise, torch.ones(length - 2 * edge), rise.flip(0)])


def _frequency(rows: int, columns: int) -> Tensor:
    """Cycles to the cell, on a half spectrum."""
    return torch.hypot(torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns)[None])


def _spread(values: Tensor, at: Tensor, frequency: Tensor) -> Tensor:
    """Values of bands at any frequency: straight lines between their logarithms."""
    least = float(at[at > 0].min()) / 2
    wanted, known = (np.log(each.clamp_min(least).numpy()) for each in (frequency, at))
    planes = [np.exp(np.interp(wanted, known, np.log(each.numpy()))) for each in values]
    return torch.from_numpy(np.stack(planes)).to(values.dtype)
