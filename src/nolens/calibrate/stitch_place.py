"""Where captured PSFs lie in one frame: all their overlaps solved together."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nolens.calibrate.register import Cells, Match, Plane, fine_structure, matched

_LEAST_ALIKE = 0.25
"""Two captures whose overlap correlates less, each part by its own norm, are not taken for views
of one mask. The 0.3 of the paper's Fig. 6c, which falls with the light too, is no such figure."""
_CHANCE, _SPOT_CELLS = 6.0, 25
"""PSFs without anything in common may come to that many times 1/√n by their best shift, where
n spots of so many pixels overlap."""
_LEAST_OVERLAP = 0.1
"""Fraction of the sensor that both must show to be compared."""
_ROBUST_CELLS = 0.5
"""Residual from which on an overlap counts less (Huber's weights)."""
_ROUNDS = 20


@dataclass(frozen=True)
class Pair:
    """Two captures and how they lie on each other.

    Parameters
    ----------
    first, second
        Their numbers.
    match
        Where the second lies against the first.
    """

    first: int
    second: int
    match: Match


@dataclass(frozen=True)
class Placement:
    """Where captures lie.

    Parameters
    ----------
    shifts
        (row, column) in pixels of every PSF against the reference's; None for one that fits
        none of the others.
    correlations
        Of each with the others, at best.
    pairs
        What the shifts were found from.
    misfit
        Root mean square, in pixels, by which the pairs disagree with the shifts.
    """

    shifts: tuple[Cells | None, ...]
    correlations: tuple[float, ...]
    pairs: tuple[Pair, ...]
    misfit: float

    def scaled(self, by: int) -> "Placement":
        """The same in pixels that are so many times finer."""
        return Placement(
            tuple(each and (by * each[0], by * each[1]) for each in self.shifts),
            self.correlations,
            tuple(Pair(pair.first, pair.second, pair.match.scaled(by)) for pair in self.pairs),
            by * self.misfit,
        )


def place(
    patterns: list[Plane],
    expected: list[Cells],
    reference: int,
    search: list[float],
    tick: Callable[[float], None] | None = None,
) -> Placement:
    r"""Find the shift of every PSF against one of them.

    Every two that overlap are matched (`matched`). Then all shifts s are solved together:
    the least :math:`\sum_{ij} w_{ij} |s_j - s_i - d_{ij}|^2` (`preibisch2009`), with weights of
    the squared correlation, and less for overlaps that contradict the others (`huber1964`).

    Parameters
    ----------
    patterns
        As the sensor saw them, alike in size.
    expected
        Their shifts as far as is known, in pixels.
    reference
        Number of the PSF that stays where it is.
    search
        Pixels by which each shift may be off.
    tick
        Called with the fraction that is done, 0 to 1.
    """
    structures = [fine_structure(each) for each in patterns]
    rows, columns = patterns[0].shape
    candidates = []
    for first in range(len(patterns)):
        for second in range(first + 1, len(patterns)):
            away = [b - a for a, b in zip(expected[first], expected[second], strict=True)]
            left = max(0.0, rows - abs(away[0])) * max(0.0, columns - abs(away[1]))
            if left >= _LEAST_OVERLAP * rows * columns:
                candidates.append((first, second, (away[0], away[1])))
    correlations = [0.0] * len(patterns)
    pairs = []
    for number, (first, second, apart) in enumerate(candidates):
        found = matched(
            structures[first], structures[second], apart, search[first] + search[second]
        )
        if found is not None:
            for each in (first, second):
                correlations[each] = max(correlations[each], found.correlation)
            if found.correlation >= _least_alike(found.cells):
                pairs.append(Pair(first, second, found))
        if tick is not None:
            tick((number + 1) / len(candidates))
    reached = _connected(pairs, reference)
    used = [pair for pair in pairs if pair.first in reached]
    shifts, misfit = _solved(used, sorted(reached), reference)
    return Placement(
        tuple(shifts.get(number) for number in range(len(patterns))),
        tuple(correlations),
        tuple(used),
        misfit,
    )


def _least_alike(cells: int) -> float:
    return max(_LEAST_ALIKE, _CHANCE * math.sqrt(_SPOT_CELLS / cells))


def _connected(pairs: list[Pair], reference: int) -> set[int]:
    """Captures that a chain of pairs leads to."""
    reached = {reference}
    while True:
        more = {
            each
            for pair in pairs
            if (pair.first in reached) != (pair.second in reached)
            for each in (pair.first, pair.second)
        } - reached
        if not more:
            return reached
        reached |= more


def _solved(
    pairs: list[Pair], numbers: list[int], reference: int
) -> tuple[dict[int, Cells], float]:
    """Shifts by number, and the weighted misfit of the pairs."""
    free = [number for number in numbers if number != reference]
    if not free:
        return {reference: (0.0, 0.0)}, 0.0
    system = np.zeros((len(pairs), len(free)))
    for row, pair in enumerate(pairs):
        for number, sign in ((pair.first, -1.0), (pair.second, 1.0)):
            if number != reference:
                system[row, free.index(number)] = sign
    measured = np.array([pair.match.moved for pair in pairs])
    trust = np.array([pair.match.correlation**2 for pair in pairs])
    weights = trust
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None]
        solution: NDArray[np.float64] = np.linalg.lstsq(system * root, measured * root, rcond=None)[
            0
        ]
        off = np.hypot(*(system @ solution - measured).T)
        weights = trust * np.minimum(1.0, _ROBUST_CELLS / np.maximum(off, 1e-9))
    shifts = {
        number: (float(row), float(column))
        for number, (row, column) in zip(free, solution, strict=True)
    }
    misfit = float(np.sqrt((weights * off**2).sum() / weights.sum()))
    return {**shifts, reference: (0.0, 0.0)}, misfit
