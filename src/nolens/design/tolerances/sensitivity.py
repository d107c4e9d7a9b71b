"""What each parameter alone does to a criterion, and what all of them will do together."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from nolens.amounts import finite_or_none
from nolens.design.tolerances.parameters import Parameter

Criterion = Callable[[Tensor], Tensor]
"""From cameras (trials, parameters), each parameter in its unit, to their figure (trials,)."""


def evaluate(
    criterion: Criterion,
    cameras: Tensor,
    *,
    at_once: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    """Evaluate cameras in portions.

    Parameters
    ----------
    criterion
        To be evaluated.
    cameras
        (trials, parameters).
    at_once
        Cameras in a portion.
    stop
        Called with the number that is done after every portion; True ends the work.

    Returns
    -------
    Tensor
        float64, one figure for each camera that was done.
    """
    figures = []
    for first in range(0, len(cameras), at_once):
        figures.append(criterion(cameras[first : first + at_once]).double())
        if stop is not None and stop(min(first + at_once, len(cameras))):
            break
    return torch.cat(figures)


@dataclass(frozen=True)
class _Sensitivity:
    """What one parameter does: change of the criterion at − and + its tolerance."""

    parameter: Parameter
    minus: float
    plus: float

    @property
    def linear(self) -> float:
        """Part of the change at + tolerance that turns its sign with the parameter."""
        return (self.plus - self.minus) / 2

    @property
    def quadratic(self) -> float:
        """Part of the change that both sides share."""
        return (self.plus + self.minus) / 2

    @property
    def worst(self) -> float:
        """The larger one of both changes, without its sign."""
        return max(abs(self.minus), abs(self.plus))

    def summary(self) -> dict[str, Any]:
        """The parameter and what it does, in values that JSON has."""
        return {
            "parameter": self.parameter.name,
            "distribution": self.parameter.distribution,
            "mean": self.parameter.middle,
            "tolerance": self.parameter.tolerance,
            "tolerance_means": self.parameter.tolerance_means,
            "unit": self.parameter.unit,
            "change_at_minus": finite_or_none(self.minus),
            "change_at_plus": finite_or_none(self.plus),
            "linear": finite_or_none(self.linear),
            "quadratic": finite_or_none(self.quadratic),
            "note": self.parameter.note,
        }


@dataclass(frozen=True)
class _Prediction:
    """What a Taylor polynomial says of all cameras: mean of the criterion, standard deviation.

    `linear_sigma` is that by the linear terms alone, the root of the sum of squares.
    """

    mean: float
    linear_sigma: float
    sigma: float


@dataclass(frozen=True)
class Response:
    r"""A criterion around the middle of all parameters.

    Parameters
    ----------
    parameters
        What varies.
    nominal
        The criterion where every parameter has its middle value.
    minus, plus
        Criterion at − and + the tolerance of each parameter, (parameters,).
    mixed
        (parameters, parameters): :math:`f_{ij} t_i t_j`, the second derivative by two parameters
        times both tolerances.
    best
        The best figure that was met on the way, see `respond`.
    """

    parameters: tuple[Parameter, ...]
    nominal: float
    minus: Tensor
    plus: Tensor
    mixed: Tensor
    best: float

    @property
    def sensitivities(self) -> tuple[_Sensitivity, ...]:
        """Parameters with what they do, the worst offender first."""
        rows = [
            _Sensitivity(each, float(minus) - self.nominal, float(plus) - self.nominal)
            for each, minus, plus in zip(self.parameters, self.minus, self.plus, strict=True)
        ]
        return tuple(sorted(rows, key=lambda row: -row.worst))

    def predict(self) -> _Prediction:
        r"""Mean and standard deviation of a second-order Taylor polynomial.

        With the derivatives :math:`f_i`, :math:`f_{ij}` and independent, symmetric parameters of
        variance :math:`σ_i^2` and fourth moment :math:`μ_i`:

        .. math::
            \mathrm{mean} = f_0 + \tfrac12 \sum_i f_{ii} σ_i^2, \qquad
            \mathrm{variance} = \sum_i f_i^2 σ_i^2 + \tfrac14 \sum_i f_{ii}^2 (μ_i - σ_i^4)
            + \sum_{i<j} f_{ij}^2 σ_i^2 σ_j^2

        The first sum of the variance is the root-sum-square rule (`jcgm100`); near the best focus
        its derivatives vanish, and the other terms are what is left.
        """
        first = (self.plus - self.minus) / 2
        second = self.plus + self.minus - 2 * self.nominal
        # Moments in units of each parameter's tolerance, as the derivatives are.
        scale = [each.tolerance or 1.0 for each in self.parameters]
        variance = torch.tensor(
            [each.variance / t**2 for each, t in zip(self.parameters, scale, strict=True)],
            dtype=torch.float64,
        )
        fourth = torch.tensor(
            [each.fourth_moment / t**4 for each, t in zip(self.parameters, scale, strict=True)],
            dtype=torch.float64,
        )
        linear = float((first.square() * variance).sum())
        pairs = self.mixed.square() * variance[:, None] * variance
        curved = (second.square() * (fourth - variance.square())).sum() / 4
        return _Prediction(
            mean=self.nominal + float((second * variance).sum()) / 2,
            linear_sigma=math.sqrt(linear),
            sigma=math.sqrt(linear + float(curved + pairs.triu(1).sum())),
        )


def sweep(
    criterion: Criterion, parameters: tuple[Parameter, ...], number: int, points: int
) -> tuple[Tensor, Tensor]:
    """Criterion over one parameter, from − to + its tolerance, all others in their middle.

    Returns
    -------
    tuple
        Values of the parameter and of the criterion, (points,), float64.
    """
    rows = torch.tensor([each.middle for each in parameters], dtype=torch.float64).repeat(points, 1)
    rows[:, number] += parameters[number].tolerance * torch.linspace(-1, 1, points).double()
    return rows[:, number], criterion(rows)


def respond(
    criterion: Criterion,
    parameters: tuple[Parameter, ...],
    *,
    smaller_is_better: bool,
    at_once: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Response:
    r"""Evaluate a criterion at ± the tolerance of every parameter, and of every two of them.

    With t the tolerances, :math:`f_{ij} t_i t_j` is half of
    :math:`f_{++} + f_{--} - f_{+0} - f_{-0} - f_{0+} - f_{0-} + 2 f_0`.

    Parameters
    ----------
    criterion
        To be evaluated.
    parameters
        What varies.
    smaller_is_better
        Which figure is the best one.
    at_once
        Cameras that are given to the criterion in one call.
    progress
        Called with the fraction that is done.
    """
    count = len(parameters)
    middle = torch.tensor([each.middle for each in parameters], dtype=torch.float64)
    steps = torch.diag(torch.tensor([each.tolerance for each in parameters], dtype=torch.float64))
    pairs = torch.combinations(torch.arange(count), 2)
    both = steps[pairs[:, 0]] + steps[pairs[:, 1]]
    offsets = torch.cat([torch.zeros(1, count).double(), steps, -steps, both, -both])

    def advance(done: int) -> bool:
        if progress is not None:
            progress(done / len(offsets))
        return False

    figures = evaluate(criterion, middle + offsets, at_once=at_once, stop=advance)
    nominal = figures[0]
    plus, minus = figures[1 : 1 + 2 * count].reshape(2, count)
    plus_both, minus_both = figures[1 + 2 * count :].reshape(2, len(pairs))
    alone = plus + minus
    mixed = torch.zeros(count, count, dtype=torch.float64)
    mixed[pairs[:, 0], pairs[:, 1]] = (
        plus_both + minus_both - alone[pairs[:, 0]] - alone[pairs[:, 1]] + 2 * nominal
    ) / 2
    best = float(figures.min() if smaller_is_better else figures.max())
    return Response(parameters, float(nominal), minus, plus, mixed + mixed.T, best)
