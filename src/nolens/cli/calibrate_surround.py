"""`nolens calibrate surround`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import CalibrateSurroundOptions, calibrate_surround


def _lines(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["cells"]
    lines = [f"{summary['from']} extended to {rows}×{columns} pixels by {summary['surround']}"]
    if summary["misfit"]:
        first, last = summary["misfit"][0], summary["misfit"][-1]
        lines.append(
            f"the reconstructions leave {100 * last:.2f} % of the measurements over, and left "
            f"{100 * first:.2f} % with the mean light; {summary['rounds']} rounds"
        )
    return lines


surround = command(CalibrateSurroundOptions, calibrate_surround, _lines, name="surround")
