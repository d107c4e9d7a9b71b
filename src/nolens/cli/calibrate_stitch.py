"""`nolens calibrate stitch` and `nolens calibrate plan`."""

from typing import Any

from nolens.cli.command import command
from nolens.jobs import (
    CalibratePlanOptions,
    CalibrateStitchOptions,
    calibrate_plan,
    calibrate_stitch,
)


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
        f"overlaps agree to {summary['misfit_cells']:.2f} pixels",
        f"{rows}×{columns} pixels, the sensor has {sensor[0]}×{sensor[1]}; "
        f"{100 * summary['known_share']:.1f} % of them were seen",
        f"the captures reach far enough for scenes of up to --support {region[0]}x{region[1]}, "
        "with --psf-extent wide; give the scene's own support (nolens calibrate plan) where that "
        "is smaller",
    ]


def _plan_lines(summary: dict[str, Any]) -> list[str]:
    cells, region = summary["cells"], summary["region"]
    return [
        f"capture a point source at {len(summary['angles_deg'])} angles, to the right and up:",
        *(f"  --angle {right:g}deg,{up:g}deg" for right, up in summary["angles_deg"]),
        f"a scene of that angle covers --support {region[0]}x{region[1]}, and the stitched PSF "
        f"will have about {cells[0]}×{cells[1]} pixels",
    ]


stitch = command(CalibrateStitchOptions, calibrate_stitch, _stitch_lines, name="stitch")
plan = command(CalibratePlanOptions, calibrate_plan, _plan_lines, name="plan")
