"""`nolens calibrate distances`."""

import json
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from nolens.cli.app import Json, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import CalibrateDistancesOptions, calibrate_distances


def distances(
    folder: Path | None = None,
    /,
    *,
    at: Annotated[tuple[str, ...] | None, Quantity] = None,
    between: Annotated[str | None, Quantity] = None,
    count: Annotated[int | None, Whole] = None,
    from_: Annotated[str | None, Quantity, Parameter(name="--from")] = None,
    reduced: Annotated[str | None, Quantity] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Make PSFs of other distances of a measured one, by how the rays magnify the pattern.

    nolens calibrate distances mycamera --at 8cm --at 20cm --at infinity

    A light at the distance z throws a pattern 1 + D/z times as large as a far one does, D being
    the reduced thickness between mask and sensor. The wider the measured PSF, the better: one that
    was stitched is taken before one that was captured.

    Parameters
    ----------
    folder
        Of the camera's PSFs, as nolens calibrate makes it. Needed.
    at
        Distance that a PSF is wanted at, or infinity; again for more.
    between
        The nearest and the farthest of several distances, such as 8cm,1m, with --count.
    count
        How many distances --between has; they are equally far apart in 1/z, as patterns are in
        size.
    from_
        Distance of the measured PSF that all come from.  [default: the nearest one, in 1/z]
    reduced
        Sum of thickness / index of the layers between mask and sensor, such as 1.28mm, where the
        folder has no camera.toml.
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    if "from_" in given:
        given["from"] = given.pop("from_")
    reporter = TerminalReporter()
    with reporter:
        summary = calibrate_distances(CalibrateDistancesOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    show(f"the layers are as thick to rays as {summary['reduced_thickness_mm']:.3f} mm of air")
    for each in summary["psfs"]:
        show(
            f"{each['file']}: {each['magnification']:.5f} times as large as {each['from']}"
            + (f", {100 * each['unknown_share']:.2g} % unknown" if each["unknown_share"] else "")
        )
    for path in summary["outputs"]:
        show(path)
    return 0
