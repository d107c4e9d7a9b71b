"""`nolens dataset`."""

from collections.abc import Iterator
from typing import Any

from cyclopts import App

from nolens.amounts import size_text
from nolens.cli.command import command
from nolens.jobs import make_dataset

dataset = App(name="dataset", help="Make data sets of simulated measurements and their truths.")


def _lines(summary: dict[str, Any]) -> Iterator[str]:
    if "shards" not in summary:
        yield f"{summary['count']} items, {summary['seconds']:.1f} s"
        return
    if summary["missing_shards"]:
        yield (
            f"{summary['missing_shards']} of {summary['shards']} shards are missing: the same "
            "command goes on"
        )
        if summary["failed"]:
            yield "a set without the pictures that cannot be used is another one, in another folder"
        return
    splits = ", ".join(f"{count} for {name}" for name, count in summary["splits"].items())
    yield (
        f"{summary['count']} items ({splits}) in {summary['shards']} shards, "
        f"{size_text(summary['bytes'])}, {summary['seconds']:.1f} s"
    )


dataset.command(command(make_dataset, _lines, name="make"), name="make")
