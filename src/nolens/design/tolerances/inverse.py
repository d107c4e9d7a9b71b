"""What the tolerance of one parameter may be for a yield."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from nolens.design.tolerances.trials import Yield

_PRECISION = 0.01
MOST_STEPS = 14
"""Yields that `largest_tolerance` asks for, where the answer is a tenth of the bound or more."""


@dataclass(frozen=True)
class Allowed:
    """The largest tolerance for a yield.

    Parameters
    ----------
    verdict
        ``"found"``; ``"impossible"`` where not even a tolerance of zero gives the yield, and
        ``"any"`` where the largest one that was tried still does.
    tolerance
        ±, in the parameter's unit.
    reached
        Yield with it.
    """

    verdict: Literal["found", "impossible", "any"]
    tolerance: float
    reached: Yield


def largest_tolerance(yield_with: Callable[[float], Yield], wanted: float, bound: float) -> Allowed:
    """Find the largest tolerance that gives a yield, by bisection to one hundredth of it.

    The same random numbers must serve every tolerance, so that the yield falls as the tolerance
    grows; where it also rises somewhere, one of the places is found at which it crosses `wanted`.

    Parameters
    ----------
    yield_with
        Yield with a tolerance.
    wanted
        Fraction from 0 to 1.
    bound
        Largest tolerance to be tried.
    """
    reached = yield_with(0.0)
    if reached.share < wanted:
        return Allowed("impossible", 0.0, reached)
    at_bound = yield_with(bound)
    if at_bound.share >= wanted:
        return Allowed("any", bound, at_bound)
    low, high = 0.0, bound
    while high - low > _PRECISION * high and high > 1e-9 * bound:
        middle = (low + high) / 2
        found = yield_with(middle)
        if found.share >= wanted:
            low, reached = middle, found
        else:
            high = middle
    return Allowed("found", low, reached)
