"""What follows from a camera's description, in figures."""

import math
from typing import Any

from nolens.camera import OpenCamera
from nolens.optics import PointSource
from nolens.twin import REFERENCE_NM, preview_model

_ANGLES_DEG = (10, 30, 50)
_DEPTH_MM = 80.0


def camera_facts(opened: OpenCamera) -> dict[str, Any]:
    """Derive figures of a camera, in values that JSON has.

    Parameters
    ----------
    opened
        The camera.

    Returns
    -------
    dict
        Size of the sensor in mm and cells; reduced thickness Σ t/n of all layers in mm; how much
        larger the pattern of a light at 80 mm is than that of a far one; shift of the chief ray
        in um by the field angle in degrees; electrons at which a pixel clips; names of the
        curves that are placeholders.
    """
    twin = preview_model(opened)
    camera, sensor = opened.camera, opened.camera.sensor
    near = twin.illumination(PointSource(distance_um=_DEPTH_MM * 1e3), REFERENCE_NM)
    curves = {
        "quantum_efficiency": opened.quantum_efficiency.source,
        "acceptance": opened.acceptance.source,
    }
    return {
        "sensor_mm": [round(sensor.height_mm, 4), round(sensor.width_mm, 4)],
        "cells": list(twin.shape),
        "layers": len(camera.layers),
        "reduced_thickness_mm": round(twin.stack().reduced_um * 1e-3, 5),
        "magnification_at_80mm": round(
            1 + near.after.reduced_um / (_DEPTH_MM * 1e3 + near.before.reduced_um), 5
        ),
        "chief_ray_um": {
            str(angle): round(
                twin.shift_um(PointSource((0.0, math.tan(math.radians(angle)))))[1], 2
            )
            for angle in _ANGLES_DEG
        },
        "clip_electrons": round(sensor.clip_electrons, 1),
        "placeholders": [
            name for name, source in curves.items() if source.startswith("placeholder")
        ],
    }
