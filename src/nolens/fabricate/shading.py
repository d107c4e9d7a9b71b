"""From which angle on the frame stands in the light's way."""

import math

import torch

from nolens.camera import Camera
from nolens.fabricate.frame import FrameGeometry
from nolens.optics import Stack
from nolens.twin import REFERENCE_NM

_STEPS = 60


def shading_angle_deg(camera: Camera, frame: FrameGeometry) -> float | None:
    r"""Field angle from which on the wall shades the pixels along the sensor's edge.

    Light with p = sin θ (Snell's law conserves it) reaches a pixel from
    :math:`D = \sum_i t_i p/\sqrt{n_i^2 - p^2}` beside it at the mask's surface, which is level
    with the frame's top. It passes the wall's upper edge while D is at most the distance a from
    the outermost pixel to the cavity's wall, plus the rim r, and the rim's lower edge while
    :math:`D - r p/\sqrt{n^2 - p^2} ≤ a`, with n the resin's index. The angle is the smaller one of
    both directions; a corner's pixel is shaded from there on too.

    Parameters
    ----------
    camera
        Its layers, at 550 nm, and its sensor, whose middle is taken as the package's.
    frame
        The frame.

    Returns
    -------
    float or None
        In degrees, 0 where the wall stands over the pixels; None where no angle is shaded.
    """
    surface = camera.mask.surface
    thicknesses = tuple(layer.thickness.um * 1e-3 for layer in camera.layers[surface:])
    indices = camera.indices(REFERENCE_NM)[surface:]
    whole = Stack(thicknesses, indices)
    below = Stack((thicknesses[0] - frame.rim_mm, *thicknesses[1:]), indices)
    sensor = camera.sensor
    room = min(
        (frame.inner_width_mm - sensor.width_mm) / 2,
        (frame.inner_height_mm - sensor.height_mm) / 2,
    )

    def passes(angle_deg: float) -> bool:
        p = torch.tensor(math.sin(math.radians(angle_deg)), dtype=torch.float64)
        upper, lower = (float(stack.displacement_um(p)) for stack in (whole, below))
        return upper <= room + frame.rim_mm and lower <= room

    low, high = 0.0, 90.0 - 1e-9
    if passes(high):
        return None
    if not passes(low):
        return 0.0
    for _ in range(_STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return low
