"""How far each spatial frequency of a measurement is to be trusted."""

import math
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
from torch import Tensor

from nolens.kernels import irfft2, rfft2

_MODEL_ERROR = 0.1
_LEAST_ERROR = 1e-3
_FADED = 8
_BANDS = 24
_NOISE_FROM = 0.45


@dataclass(frozen=True)
class Weights:
    r"""Inverse covariance of what a measurement is off: W = T F* (1/P) F T.

    Noise is white, but what the model leaves out (light that comes aslant, misregistration, light
    from beside the picture) is a share of the light itself: P(f) = N + ε(f) S(f), with the power S
    of the measurement by spatial frequency and its noise N at the highest ones. The share ε is a
    tenth to begin with, and then what a solution was off, in the mean over all measurements
    (`learnt`): feasible generalised least squares (`aitken1936`, `zellner1962`). T fades out
    towards the sensor's edges and is zero where a pixel is saturated.

    Attributes
    ----------
    taper
        T, (measurements, rows, columns).
    bands
        Number of each frequency's band, on the half spectrum of the sensor, flattened.
    frequencies
        Mean of each band, in cycles to the cell.
    power
        S, (measurements, bands).
    expected
        P, (measurements, bands).
    spectrum
        1/P, (measurements, rows, columns // 2 + 1).
    """

    taper: Tensor
    bands: Tensor
    frequencies: Tensor
    power: Tensor
    expected: Tensor
    spectrum: Tensor

    @classmethod
    def of(cls, measured: Tensor, valid: Tensor) -> Self:
        """Find them of measurements, (measurements, rows, columns)."""
        rows, columns = measured.shape[-2:]
        taper = torch.outer(_faded(rows), _faded(columns)) * valid
        frequency = _frequency(rows, columns)
        edges = torch.logspace(math.log10(0.75 / min(rows, columns)), math.log10(0.75), _BANDS)
        _, bands = torch.bucketize(frequency, edges).flatten().unique(return_inverse=True)
        middle = _band_means(frequency[None], bands)[0]
        power = _power(measured, taper, bands)
        return cls(taper, bands, middle, power, power, torch.empty(0))._expecting(_MODEL_ERROR)

    def learnt(self, off: Tensor) -> Self:
        """The same for what a solution was off, (measurements, rows, columns)."""
        beyond_noise = (_power(off, self.taper, self.bands) - self._noise).clamp_min(0)
        share = (beyond_noise / self.power).mean(dim=0).clamp(_LEAST_ERROR, 1)
        return self._expecting(share)

    @property
    def _noise(self) -> Tensor:
        return self.power[:, self.frequencies >= _NOISE_FROM].amin(dim=1, keepdim=True)

    def _expecting(self, share: Tensor | float) -> Self:
        expected = self._noise + share * self.power
        rows, columns = self.taper.shape[-2:]
        spectrum = _spread(1 / expected, self.frequencies, _frequency(rows, columns))
        return replace(self, expected=expected, spectrum=spectrum)

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


def _power(values: Tensor, taper: Tensor, bands: Tensor) -> Tensor:
    """Mean power of each pixel in each band, (measurements, bands)."""
    spectrum = rfft2(values * taper).abs().square()
    return _band_means(spectrum, bands) / taper.square().sum(dim=(-2, -1))[:, None]


def _band_means(planes: Tensor, bands: Tensor) -> Tensor:
    count = torch.bincount(bands)
    return torch.stack([torch.bincount(bands, each.flatten()) / count for each in planes])


def _frequency(rows: int, columns: int) -> Tensor:
    """Cycles to the cell, on a half spectrum."""
    return torch.hypot(torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns)[None])


def _spread(values: Tensor, at: Tensor, frequency: Tensor) -> Tensor:
    """Values of bands at any frequency: straight lines between their logarithms."""
    least = float(at[at > 0].min()) / 2
    wanted, known = (np.log(each.clamp_min(least).numpy()) for each in (frequency, at))
    planes = [np.exp(np.interp(wanted, known, np.log(each.numpy()))) for each in values]
    return torch.from_numpy(np.stack(planes)).to(values.dtype)
