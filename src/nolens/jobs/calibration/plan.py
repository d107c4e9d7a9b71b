"""`nolens calibrate plan`: at which angles PSFs must be captured to stitch one for a scene."""

import math
from typing import Annotated, Any

from pydantic import BeforeValidator

from nolens.calibrate.distances import Layers
from nolens.camera.part import refusal
from nolens.errors import OptionError
from nolens.files import read_camera
from nolens.jobs.fields import CAMERAS, FullAngle, Name
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.operators import Region
from nolens.quantities import Angle
from nolens.twin import LARGEST_ANGLE_DEG

_MORE_DEG = 1.0
"""Beyond the scene's edge, as the angles will not be met exactly."""
_NARROW_DEG = 20.0
"""Half a scene's width to which the corners and the middle are as good as all nine."""


def _one_or_two(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    parts = given.split(",")
    if len(parts) > 2:
        raise refusal(
            "give the angle that the scene fills, or width and height: 56deg or 56deg,42deg"
        )
    return parts[0], parts[-1]


class CalibratePlanOptions(JobOptions):
    """List the angles at which to capture PSFs for nolens calibrate stitch.

    nolens calibrate plan paper --angle 56deg
    """

    usage = "calibrate plan CAMERA --angle 56deg"

    camera: Annotated[
        Name,
        Option(f"{CAMERAS}.", role="camera", positional=True),
    ] = "paper"
    angle: Annotated[
        tuple[FullAngle, FullAngle],
        BeforeValidator(_one_or_two),
        Option(
            "Which angle the scene fills, or its width and height, such as 56deg,42deg.",
            needed="the angle that the scene fills (--angle 56deg, or width and height: --angle "
            "56deg,42deg)",
        ),
    ]

    @property
    def written(self) -> tuple[Written, ...]:
        """Nothing."""
        return ()


@job
def calibrate_plan(run: Run[CalibratePlanOptions]) -> Product[list[tuple[float, float]]]:
    """List the angles at which a point source must be captured for a scene of some width.

    Raises
    ------
    NolensError
        If the camera or an option cannot be used.
    """
    options = run.options
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
        (right * edges[0] + 0.0, up * edges[1] + 0.0)
        for up in (1, 0, -1)
        for right in (-1, 0, 1)
        if max(half) > _NARROW_DEG or abs(right) == abs(up)
    ]
    figures = {
        "camera": opened.camera.name,
        "angles_deg": [[right, up] for right, up in grid],
        "corner_deg": round(corner, 2),
        "sensor_cells": list(cells),
        "region": [region.height, region.width],
        "cells": [cells[0] + region.height, cells[1] + region.width],
    }
    return Product(grid, figures)
