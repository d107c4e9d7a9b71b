"""`nolens train`."""

from collections.abc import Iterator
from typing import Any

from nolens.cli.command import command
from nolens.jobs import train as train_job


def _lines(summary: dict[str, Any]) -> Iterator[str]:
    yield (
        f"{summary['prior']}: {summary['steps']} of {summary['steps_planned']} steps, "
        f"{summary['seconds']:.1f} s"
    )
    yield (
        f"pictures held out: {summary['validation_db']:.2f} dB; it began with "
        f"{summary['validation_start_db']:.2f} dB, and without a network there are "
        f"{summary['validation_before_db']:.2f} dB"
    )
    if summary["stop_reason"] == "interrupted":
        yield "the same command goes on with --resume and the .state.npz"


train = command(train_job, _lines, name="train")
