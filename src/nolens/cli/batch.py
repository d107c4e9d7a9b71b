"""`nolens batch`: jobs over sets of files."""

from collections.abc import Callable
from typing import Any

from cyclopts import App

from nolens.cli.command import command

_HERE = "nolens.cli.batch"
_MEASURED = ("psf", "siemens", "edge", "two-points")

batch = App(name="batch", help="Do a job for every item of a set, on all cores or a cluster.")
for _name in ("reconstruct", "refocus", "simulate", "measure"):
    batch.command(f"{_HERE}:{_name}")


def __getattr__(name: str) -> App | Callable[..., int]:
    """Make the command of a name."""
    if name == "reconstruct":
        from nolens.jobs import BatchReconstructOptions, batch_reconstruct

        return command(batch_reconstruct, _lines, name=name, options=BatchReconstructOptions)
    if name == "measure":
        app = App(name=name, help="Measure every item of a set; batch.json has the figures.")
        for each in _MEASURED:
            app.command(f"{_HERE}:{each}", name=each)
        return app
    if name in ("refocus", "simulate", *_MEASURED):
        from nolens.jobs import batch_each, batch_options

        return command(batch_each, _lines, name=name, options=batch_options(name))
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def _lines(summary: dict[str, Any]) -> list[str]:
    failed = f", {len(summary['failed'])} failed" if summary["failed"] else ""
    return [
        f"{summary['done']} of {summary['items']} done ({summary['made']} of them now){failed}; "
        f"{summary['stop_reason']}, {summary['seconds']:.1f} s"
    ]
