"""How a parameter of a camera is distributed over the cameras that are made."""

import math
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri
from torch import Tensor

Distribution = Literal["normal", "uniform", "triangular"]
DISTRIBUTIONS: tuple[str, ...] = get_args(Distribution)
"""Names of all distributions."""

_SIGMAS = 2.0
"""Standard deviations in the tolerance of a normal distribution: 95.4 % lie within it."""


@dataclass(frozen=True)
class Parameter:
    r"""One quantity that comes out a little different in every camera.

    All distributions are symmetric around `middle`. The tolerance ± is 2 σ of a normal one, and
    the farthest value of a uniform or triangular one.

    Parameters
    ----------
    name
        Such as ``"resin.thickness"``.
    distribution
        One of `DISTRIBUTIONS`.
    middle
        Mean value, in `unit`.
    tolerance
        ±, in `unit`; 0 or more.
    unit
        ``"um"``, ``"deg"``, ``"%"``, or ``""`` for an index.
    at_most
        Farthest from the middle that a normal one can come, where parts beyond are sorted out.
    note
        Why.
    """

    name: str
    distribution: Distribution
    middle: float
    tolerance: float
    unit: str
    at_most: float | None = None
    note: str = ""

    @property
    def tolerance_means(self) -> str:
        """What ± stands for: ``"2σ"``, or ``"at most"`` where nothing lies farther away."""
        return f"{_SIGMAS:g}σ" if self.distribution == "normal" else "at most"

    def with_tolerance(self, tolerance: float) -> "Parameter":
        """The same with another tolerance; where it is cut changes in proportion."""
        at_most = self.at_most
        if at_most is not None and self.tolerance > 0:
            at_most *= tolerance / self.tolerance
        return replace(self, tolerance=tolerance, at_most=at_most)

    def values(self, shares: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values below which the given fractions of all cameras lie: the inverse of the CDF.

        Parameters
        ----------
        shares
            More than 0 and less than 1, any shape.
        """
        if self.distribution == "normal":
            tail = ndtr(-self._cut)
            unit = ndtri(tail + shares * (1 - 2 * tail)) / _SIGMAS
        elif self.distribution == "uniform":
            unit = 2 * shares - 1
        else:
            nearer = np.minimum(shares, 1 - shares)
            unit = np.copysign(1 - np.sqrt(2 * nearer), shares - 0.5)
        values: NDArray[np.float64] = self.middle + self.tolerance * unit
        return values

    @property
    def variance(self) -> float:
        """Second central moment, in the unit's square."""
        if self.distribution == "normal":
            tails = 2 * self._cut * self._density / self._kept if math.isfinite(self._cut) else 0.0
            return (1 - tails) * (self.tolerance / _SIGMAS) ** 2
        return self.tolerance**2 / (3 if self.distribution == "uniform" else 6)

    @property
    def fourth_moment(self) -> float:
        """Fourth central moment."""
        if self.distribution == "normal":
            cut = self._cut
            tails = 2 * (cut**3 + 3 * cut) * self._density / self._kept if cut < math.inf else 0.0
            return (3 - tails) * (self.tolerance / _SIGMAS) ** 4
        return self.tolerance**4 / (5 if self.distribution == "uniform" else 15)

    @property
    def _cut(self) -> float:
        """Standard deviations at which a normal distribution is cut."""
        if self.at_most is None or self.tolerance == 0:
            return math.inf
        return self.at_most / (self.tolerance / _SIGMAS)

    @property
    def _density(self) -> float:
        return math.exp(-(self._cut**2) / 2) / math.sqrt(2 * math.pi)

    @property
    def _kept(self) -> float:
        return float(1 - 2 * ndtr(-self._cut))


def shares(name: str, trials: int, seed: int) -> NDArray[np.float64]:
    """Random fractions between 0 and 1 for one parameter, the same for one name and seed.

    More trials begin with those of fewer, and other parameters change nothing.

    Parameters
    ----------
    name
        Of the parameter.
    trials
        How many.
    seed
        0 or more.
    """
    generator = np.random.default_rng([seed, *name.encode()])
    # Never 0, whose normal value is infinite.
    return np.maximum(generator.random(trials), np.finfo(np.float64).tiny)


def draw(parameters: tuple[Parameter, ...], trials: int, seed: int) -> Tensor:
    """Draw cameras.

    Parameters
    ----------
    parameters
        Independent of each other.
    trials
        How many cameras.
    seed
        0 or more.

    Returns
    -------
    Tensor
        float64, (trials, parameters), each in its unit.
    """
    columns = [each.values(shares(each.name, trials, seed)) for each in parameters]
    return torch.from_numpy(np.stack(columns, axis=1))
