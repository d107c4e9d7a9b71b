"""Intervals of a mean by resampling, without a distribution being assumed."""

import math
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np
from numpy.typing import NDArray
from scipy import special

_RESAMPLES = 4000
_AT_ONCE = 2_000_000
_LEAST = 4


@dataclass(frozen=True)
class Interval:
    """A mean and where it lies with a stated probability.

    Parameters
    ----------
    mean
        Of the values.
    low, high
        Ends; NaN of fewer than four values.
    """

    mean: float
    low: float
    high: float


def bootstrap_mean(values: NDArray[np.float64], *, level: float = 0.95, seed: int = 0) -> Interval:
    """Interval of the mean, bias-corrected and accelerated (`efron1987`).

    Few values are resampled too closely: the quantiles are widened to Student's (`hesterberg2015`).
    Of paired differences, it says whether one method is better than another on the same pictures.

    Parameters
    ----------
    values
        One for each picture.
    level
        Probability that the interval covers the mean.
    seed
        Of the resampling.
    """
    count, mean = len(values), float(np.mean(values))
    spread = values - mean
    if count < _LEAST:
        return Interval(mean, math.nan, math.nan)
    if not spread.any():
        return Interval(mean, mean, mean)
    generator = np.random.default_rng(seed)
    part = max(1, _AT_ONCE // count)
    means = np.concatenate([
        values[generator.integers(count, size=(min(part, _RESAMPLES - done), count))].mean(axis=1)
        for done in range(0, _RESAMPLES, part)
    ])  # fmt: skip
    normal = NormalDist()
    below = (np.sum(means < mean) + np.sum(means == mean) / 2) / _RESAMPLES
    bias = normal.inv_cdf(min(max(float(below), 1 / _RESAMPLES), 1 - 1 / _RESAMPLES))
    # Of a mean, the jackknife's third moment is that of the values.
    acceleration = float((spread**3).sum() / (6 * (spread**2).sum() ** 1.5))
    ends = []
    for tail in ((1 - level) / 2, (1 + level) / 2):
        wider = math.sqrt(count / (count - 1)) * float(special.stdtrit(count - 1, tail))
        moved = bias + wider
        ends.append(normal.cdf(bias + moved / (1 - acceleration * moved)))
    low, high = np.quantile(means, ends)
    return Interval(mean, float(low), float(high))
