"""`nolens calibrate distances`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import CalibrateDistancesOptions, calibrate_distances


def _lines(summary: dict[str, Any]) -> list[str]:
    return [
        f"the layers are as thick to rays as {summary['reduced_thickness_mm']:.3f} mm of air",
        *(
            f"{each['file']}: {each['magnification']:.5f} times as large as {each['from']}"
            + (f", {100 * each['unknown_share']:.2g} % unknown" if each["unknown_share"] else "")
            for each in summary["psfs"]
        ),
    ]


distances = command(CalibrateDistancesOptions, calibrate_distances, _lines, name="distances")
