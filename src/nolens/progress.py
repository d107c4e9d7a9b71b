"""Callbacks that computations call with the fraction of their work that is done."""

from collections.abc import Callable

ProgressCallback = Callable[[float], None]


def part_of(progress: ProgressCallback | None, number: int, count: int) -> ProgressCallback:
    """Callback for one of several equal parts of the work; it does nothing where there is none.

    Parameters
    ----------
    progress
        Called with the fraction of all parts, 0 to 1.
    number
        Of the part, from 0.
    count
        How many parts there are.
    """

    def report(fraction: float) -> None:
        if progress is not None:
            progress((number + fraction) / count)

    return report


def within(progress: ProgressCallback | None, start: float, length: float) -> ProgressCallback:
    """Callback for a part of the work that begins at a fraction of it and is as long as another."""

    def report(fraction: float) -> None:
        if progress is not None:
            progress(start + length * fraction)

    return report
