"""Many cameras drawn at random: their figures, levels and yield."""

import math
from dataclasses import dataclass

from scipy.special import ndtri
from torch import Tensor

LEVELS = (0.98, 0.90, 0.80, 0.50, 0.10)
"""Fractions of all cameras for which a level is given."""


def levels(figures: Tensor, *, smaller_is_better: bool) -> dict[float, float]:
    """Figures that shares of all cameras meet or do better than.

    Parameters
    ----------
    figures
        Of the trials.
    smaller_is_better
        Which way is better.

    Returns
    -------
    dict
        For each of `LEVELS`, the figure of the camera that this fraction, rounded up to whole
        cameras, is not worse than.
    """
    ordered = figures.sort(descending=not smaller_is_better).values
    return {level: float(ordered[math.ceil(level * len(ordered) - 1e-9) - 1]) for level in LEVELS}


@dataclass(frozen=True)
class Yield:
    """Fraction of cameras that meet a limit.

    Parameters
    ----------
    passed, trials
        Cameras that met it, of how many.
    """

    passed: int
    trials: int

    @classmethod
    def of(cls, figures: Tensor, limit: float, *, smaller_is_better: bool) -> "Yield":
        """Count the trials that meet a limit."""
        met = figures <= limit if smaller_is_better else figures >= limit
        return cls(int(met.sum()), len(figures))

    @property
    def share(self) -> float:
        """Fraction of the trials."""
        return self.passed / self.trials

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        r"""Wilson's interval for the fraction of all cameras (`wilson1927`).

        .. math::
            \frac{p + z^2/2n \pm z \sqrt{p(1-p)/n + z^2/4n^2}}{1 + z^2/n}

        with p the fraction of n trials and z the normal quantile of the confidence.
        """
        n, p = self.trials, self.share
        z = float(ndtri(0.5 + confidence / 2))
        middle = p + z * z / (2 * n)
        half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        scale = 1 + z * z / n
        # At 0 and 1 the ends are exact, but for rounding.
        low = 0.0 if self.passed == 0 else (middle - half) / scale
        high = 1.0 if self.passed == n else (middle + half) / scale
        return low, high
