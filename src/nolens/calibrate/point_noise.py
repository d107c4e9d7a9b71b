"""Noise of a sensor, from the frames themselves."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera import Sensor

_BINS = 48
_LEAST_IN_BIN = 64
_ROUNDING = 1 / 12
"""Variance of a count that is rounded to a whole one."""
_LAPLACES = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
_LAPLACES_POWER = 36.0


@dataclass(frozen=True)
class Noise:
    r"""Noise of one frame: the variance of a pixel is :math:`σ^2 + g\,s` for a signal s in counts.

    Parameters
    ----------
    read_variance
        σ² without light, in counts².
    counts_per_electron
        g, the slope of shot noise.
    known_from
        Two or more frames, the camera's description, or the fine structure of one picture.
    """

    read_variance: float
    counts_per_electron: float
    known_from: Literal["frames", "camera", "picture"]

    def variance(self, signal: Tensor) -> Tensor:
        """Variance of a pixel of one frame, in counts²."""
        return self.read_variance + self.counts_per_electron * signal.clamp_min(0)


def noise_of_sensor(sensor: Sensor) -> Noise:
    """Noise as the description of the sensor has it."""
    slope = sensor.counts_per_electron * sensor.gain
    read = (sensor.read_noise_electrons * slope) ** 2
    return Noise(read + _ROUNDING, slope, "camera")


def noise_of_samples(signals: list[Tensor], squares: list[Tensor], source: Noise) -> Noise:
    r"""Fit the photon transfer curve :math:`v(s) = σ^2 + g\,s` (`janesick2007`).

    Pixels are gathered by their signal into bins of equal number; a line is laid through the
    bins' means, each weighted by its own spread, :math:`v/\sqrt{N/2}`, in a few rounds.

    Parameters
    ----------
    signals
        Counts above black, of pixels that are not saturated; any shape.
    squares
        For each, a square whose mean is the variance of one frame.
    source
        Where the squares come from; its figures serve where there are too few pixels for bins.
    """
    signal = torch.cat([each.flatten() for each in signals]).double()
    square = torch.cat([each.flatten() for each in squares]).double()
    bins = min(_BINS, len(signal) // _LEAST_IN_BIN)
    if bins < 2:
        return source
    order = signal.argsort()
    groups = [torch.tensor_split(each[order], bins) for each in (signal, square)]
    mean, variance = (torch.stack([part.mean() for part in group]) for group in groups)
    fitted = variance.clamp_min(_ROUNDING)
    read, slope = float(fitted.min()), 0.0
    for _ in range(5):
        weight = fitted.square().reciprocal()
        centre = (weight * mean).sum() / weight.sum()
        level = (weight * variance).sum() / weight.sum()
        spread = (weight * (mean - centre).square()).sum()
        if float(spread) > 0:
            slope = float((weight * (mean - centre) * (variance - level)).sum() / spread)
        slope = max(slope, 0.0)
        read = max(float(level - slope * centre), _ROUNDING)
        fitted = read + slope * mean.clamp_min(0)
    return Noise(read, slope, source.known_from)


def noise_squares(plane: Tensor) -> Tensor:
    r"""Squares with the mean σ², from the fine structure of one picture (`immerkaer1996`).

    The difference of two Laplace operators, :math:`[1, -2, 1]^T [1, -2, 1]`, lets nothing smooth
    pass, and multiplies the variance of noise by 36.

    Parameters
    ----------
    plane
        (rows, columns) of one colour.

    Returns
    -------
    Tensor
        (rows − 2, columns − 2).
    """
    kernel = torch.tensor(_LAPLACES, dtype=plane.dtype)[None, None]
    return nnf.conv2d(plane[None, None], kernel)[0, 0].square() / _LAPLACES_POWER
