"""`nolens reproduce`."""

import json
from pathlib import Path
from typing import Annotated, Any

from cyclopts import Parameter

from nolens.cli.app import Json, Output, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.reproduction import ReproduceOptions
from nolens.reproduction import reproduce as run


def reproduce(
    *,
    output: Annotated[Path, Output],
    quick: Annotated[bool, Parameter(negative=(), show_default=False)] = False,
    seed: Annotated[int | None, Whole, Parameter(show_default=False)] = None,
    camera: Annotated[str | None, Parameter(show_default=False)] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Make every figure of the paper again that simulation can give, beside the paper's values.

    nolens reproduce -o report/ --quick

    Writes report.html and report.pdf, which are the same to the byte for the same seed; the
    record report.json; the pictures; timing.json with all that differs from run to run; and
    reproduction.md with both. Parts that are done are kept in steps/, so a run that was stopped
    goes on when it is started again.

    Parameters
    ----------
    output
        Folder of the report: new, empty, or that of an earlier one.
    quick
        A part of the sensor, with fewer PSFs and iterations: minutes instead of half an hour.
        [default: off]
    seed
        Number that the noise of all frames is drawn from, 0 or more.  [default: 0]
    camera
        Camera to make them with: a preset, a folder with camera.toml, or a .toml file.
        [default: paper]
    json_
        Print one JSON object on standard output.
    """
    options = ReproduceOptions.checked(given_options(locals()))
    with TerminalReporter() as reporter:
        summary = run(options, reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _lines(summary):
        show(line)
    return 0


def _lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    for row in summary["rows"]:
        ratio = "" if row["ratio"] is None else f"  ({row['ratio']:.2f})"
        reduced = " (reduced size)" if row["reduced"] else ""
        lines.append(f"{row['what']}: {row['text']}{reduced}; the paper: {row['paper']}{ratio}")
    return [*lines, "", *summary["outputs"]]
