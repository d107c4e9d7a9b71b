"""`nolens calibrate stitch` and `nolens calibrate plan`."""

import json
from pathlib import Path
from typing import Annotated, Any

from nolens.cli.app import Json, Quantity, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import (
    CalibratePlanOptions,
    CalibrateStitchOptions,
    calibrate_plan,
    calibrate_stitch,
)


def stitch(
    folder: Path | None = None,
    /,
    *,
    distance: Annotated[str | None, Quantity] = None,
    reduced: Annotated[str | None, Quantity] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Merge PSFs that were captured at several angles into one wider than the sensor.

    nolens calibrate stitch mycamera

    nolens reconstruct raw.dng --psf mycamera/stitched-300mm.tif --psf-wider --region 414x414

    A camera without an aperture sees light through mask that the PSF from straight ahead does
    not show. Lights from the side move the pattern, so that the sensor sees its other parts:
    nolens calibrate plan lists the angles. They need be right to 3° only: each PSF is placed by
    what it has in common with the others.

    Parameters
    ----------
    folder
        Of the camera's PSFs, as nolens calibrate makes it, with one from straight ahead and
        others at angles (--angle). Needed.
    distance
        Of the lights.  [default: the only one that was captured at angles]
    reduced
        Sum of thickness / index of the layers between mask and sensor, such as 1.28mm, where the
        folder has no camera.toml.
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = calibrate_stitch(CalibrateStitchOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _stitch_lines(summary):
        show(line)
    return 0


def plan(
    camera: str | None = None,
    /,
    *,
    angle: Annotated[str | None, Quantity] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """List the angles at which to capture PSFs for nolens calibrate stitch.

    nolens calibrate plan paper --angle 56deg

    Parameters
    ----------
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.  [default:
        paper]
    angle
        Which angle the scene fills, or its width and height, such as 56deg,42deg. Needed.
    json_
        Print one JSON object on standard output.
    """
    summary = calibrate_plan(CalibratePlanOptions.gather(given_options(locals()))).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _plan_lines(summary):
        show(line)
    return 0


def _stitch_lines(summary: dict[str, Any]) -> list[str]:
    lines = []
    for row in summary["captures"]:
        right, up = row["shift_um"]
        lines.append(
            f"{row['file']}: {right:z.1f} µm to the right and {up:z.1f} µm up, {row['off_um']:.1f} "
            f"µm beside its angle ({row['off_deg']:.2f}°); brightness {row['gain'][0]:.3f}, "
            f"correlation {row['correlation']:.3f}"
        )
    rows, columns = summary["cells"]
    sensor = summary["sensor_cells"]
    region = summary["region"]
    return [
        *lines,
        f"overlaps agree to {summary['misfit_cells']:.2f} cells",
        f"{rows}×{columns} cells, the sensor has {sensor[0]}×{sensor[1]}; "
        f"{100 * summary['known_share']:.1f} % of them were seen",
        f"the captures reach far enough for scenes of up to --region {region[0]}x{region[1]}, with "
        "--psf-wider; give the scene's own region (nolens calibrate plan) where that is smaller",
        *summary["outputs"],
    ]


def _plan_lines(summary: dict[str, Any]) -> list[str]:
    cells, region = summary["cells"], summary["region"]
    return [
        f"capture a point source at {len(summary['angles_deg'])} angles, to the right and up:",
        *(f"  --angle {right:g}deg,{up:g}deg" for right, up in summary["angles_deg"]),
        f"a scene of that angle covers --region {region[0]}x{region[1]}, and the stitched PSF will "
        f"have about {cells[0]}×{cells[1]} pixels",
    ]
