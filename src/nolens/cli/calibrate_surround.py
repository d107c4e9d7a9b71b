"""`nolens calibrate surround`."""

import json
from pathlib import Path
from typing import Annotated, Any

from nolens.cli.app import Json, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CalibrateSurroundOptions, calibrate_surround


def surround(
    folder: Path | None = None,
    /,
    *pictures: Path,
    region: str | None = None,
    distance: Annotated[str | None, Quantity] = None,
    rounds: Annotated[int | None, Whole] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Extend a captured PSF beyond the sensor, without further captures.

    nolens calibrate surround mycamera raw1.dng raw2.dng --region 414x414

    nolens reconstruct raw1.dng --psf mycamera/extended-300mm.tif --psf-wider --region 414x414

    For a camera without an aperture. Without pictures, the PSF goes on with its mean light; that
    alone is worth most. From pictures of ordinary scenes the pattern itself is estimated together
    with the scenes, where they show it: scenes that fill a small part of the sensor do. Captures
    at angles give more than either (nolens calibrate stitch).

    Ctrl-C ends it after a step, and the PSF so far is written.

    Parameters
    ----------
    folder
        Of the camera's PSFs, as nolens calibrate makes it. Needed.
    pictures
        Raw frames of different scenes, whose light comes from the region only.
    region
        Where the light comes from: HEIGHTxWIDTH in cells, around the middle, or +TOP+LEFT after
        it; nolens calibrate plan tells it for an angle. Needed.
    distance
        Of the PSF to extend.  [default: the only captured one]
    rounds
        Turns in which scenes and PSF are estimated.  [default: 4]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = calibrate_surround(CalibrateSurroundOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
    else:
        for line in _lines(summary):
            show(line)
    return 130 if reporter.interrupted else 0


def _lines(summary: dict[str, Any]) -> list[str]:
    rows, columns = summary["cells"]
    lines = [f"{summary['from']} extended to {rows}×{columns} cells by {summary['surround']}"]
    if summary["misfit"]:
        first, last = summary["misfit"][0], summary["misfit"][-1]
        lines.append(
            f"the reconstructions leave {100 * last:.2f} % of the measurements over, and left "
            f"{100 * first:.2f} % with the mean light; {summary['rounds']} rounds"
        )
    return [*lines, *summary["outputs"]]
