"""A plot of what was measured, and the record of the run beside it."""

from pathlib import Path

from nolens.jobs.fields import record_beside
from nolens.jobs.options import Written

RESULT = "Result"
"""Heading of what is written."""


def plot_and_record(plot: Path | None) -> tuple[Written, ...]:
    """Both files, where a plot is asked for."""
    if plot is None:
        return ()
    return (
        Written("plot", plot, "--plot", (".png",)),
        Written("record of the run", record_beside(plot), "--plot"),
    )
