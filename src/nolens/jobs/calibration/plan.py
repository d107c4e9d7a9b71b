"""At which angles PSFs must be captured to stitch one for a scene."""

import math
from dataclasses import dataclass
from typing import Any

from nolens.calibrate.distances import Layers
from nolens.errors import OptionError
from nolens.files import read_camera
from nolens.jobs.calibration.stitch_options import CalibratePlanOptions
from nolens.operators import Region
from nolens.quantities import Angle
from nolens.twin import LARGEST_ANGLE_DEG

_MORE_DEG = 1.0
"""Beyond the scene's edge, as the angles will not be met exactly."""
_NARROW_DEG = 20.0
"""Half a scene's width to which the corners and the middle are as good as all nine."""


@dataclass(frozen=True)
class CalibratePlanOutcome:
    """Angles of captures.

    Parameters
    ----------
    summary
        Figures, in values that JSON has.
    """

    summary: dict[str, Any]


def calibrate_plan(options: CalibratePlanOptions) -> CalibratePlanOutcome:
    """List the angles at which a point source must be captured for a scene of some width.

    Parameters
    ----------
    options
        Which camera, and what the scene fills.

    Raises
    ------
    NolensError
        If the camera or an option cannot be used.
    """
    opened = read_camera(options.camera)
    layers, sensor = Layers.of_camera(opened.camera), opened.camera.sensor
    per_cell = 1 if sensor.mosaic == "none" else 2
    cells = sensor.rows // per_cell, sensor.columns // per_cell
    half = [each.deg / 2 for each in options.angle]
    edges = [math.ceil(2 * (each + _MORE_DEG)) / 2 for each in half]
    corner = math.degrees(math.atan(math.hypot(*(math.tan(math.radians(e)) for e in edges))))
    if corner > LARGEST_ANGLE_DEG:
        raise OptionError(
            f"a scene of {options.angle[0]} by {options.angle[1]} has its corners {corner:.0f} deg "
            f"off the axis, and cameras see to {LARGEST_ANGLE_DEG:g} deg: choose a smaller angle, "
            "or give the height too (--angle 80deg,45deg)"
        )
    across = [
        layers.shift_um((Angle.of(half[0], "deg"), Angle.of(0, "deg")))[0],
        layers.shift_um((Angle.of(0, "deg"), Angle.of(half[1], "deg")))[1],
    ]
    step = sensor.pitch.um * per_cell
    width, height = (2 * math.ceil(each / step) for each in across)
    region = Region.centred(height, width, cells)
    grid = [
        (right * edges[0], up * edges[1])
        for up in (1, 0, -1)
        for right in (-1, 0, 1)
        if max(half) > _NARROW_DEG or abs(right) == abs(up)
    ]
    summary = {
        "camera": opened.camera.name,
        "angles_deg": [[right + 0.0, up + 0.0] for right, up in grid],
        "corner_deg": round(corner, 2),
        "sensor_cells": list(cells),
        "region": [region.height, region.width],
        "cells": [cells[0] + region.height, cells[1] + region.width],
    }
    return CalibratePlanOutcome(summary)
