"""`nolens batch`: jobs over sets of frames."""

from collections.abc import Callable
from typing import Any

from cyclopts import App

from nolens.cli.command import command

_HERE = "nolens.cli.batch"

batch = App(name="batch", help="Do a job for every frame of a set, on all cores or a cluster.")
for _name in ("reconstruct",):
    batch.command(f"{_HERE}:{_name}")


def __getattr__(name: str) -> Callable[..., int]:
    """Make the command of a name."""
    if name == "reconstruct":
        from nolens.jobs import BatchReconstructOptions, batch_reconstruct

        return command(batch_reconstruct, _lines, name=name, options=BatchReconstructOptions)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _lines(summary: dict[str, Any]) -> list[str]:
    failed = f", {len(summary['failed'])} failed" if summary["failed"] else ""
    return [
        f"{summary['done']} of {summary['items']} done{failed}, {summary['made']} of them now "
        f"({summary['stop_reason']}), {summary['seconds']:.1f} s"
    ]
