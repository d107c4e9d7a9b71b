"""What can be known of a simulated camera before its relief is computed."""

import math
from dataclasses import replace

from nolens.camera import OpenCamera, RandomLenslets, ReliefFile
from nolens.errors import OptionError
from nolens.optics import surface_bytes
from nolens.quantities import Length
from nolens.twin.model import Twin, described_lenslets

_LENSLETS = 10
_POINTS = 500
"""Sides of the patch that stands for all random lenslets: this many of them, or points."""
_BYTES_PER_HEIGHT = 4
_STEPS = 10
"""Places that lenslets are spread on, along a pitch (see `random_lenslets`)."""


def preview_model(opened: OpenCamera, *, fresnel: bool = True) -> Twin:
    """Make a camera ready for rays and for estimates, in a moment.

    Parameters
    ----------
    opened
        The camera.
    fresnel
        Whether light is lost at surfaces.

    Returns
    -------
    Twin
        Of random lenslets, which take seconds and gigabytes, it has only a patch.

    Raises
    ------
    OptionError
        If the relief is coarser than its lenslets or the light need.
    """
    relief = opened.camera.mask.relief
    if not isinstance(relief, RandomLenslets):
        return Twin.of(opened, fresnel=fresnel)
    if relief.pitch.exact < 2 * relief.grid.exact:
        raise OptionError(
            f"the relief of {opened.camera.name!r} has a lenslet every {relief.pitch}, but a point "
            f"only every {relief.grid}: give it a grid of {relief.pitch.um / _STEPS:.2g} µm or "
            "finer, or a larger pitch"
        )
    side_um = min(_LENSLETS * relief.pitch.um, _POINTS * relief.grid.um)
    patch = described_lenslets(opened.camera, (side_um, side_um))
    file = ReliefFile(kind="file", file="patch.tif", grid=relief.grid)
    mask = opened.camera.mask.model_copy(update={"relief": file})
    camera = opened.camera.model_copy(update={"mask": mask})
    twin = Twin.of(replace(opened, camera=camera, relief_um=patch.height_um), fresnel=fresnel)
    return replace(twin, camera=opened.camera)


def relief_points(opened: OpenCamera) -> float:
    """Points that the relief of random lenslets is computed on, and its lenslets are spread on."""
    camera = opened.camera
    relief, sensor = camera.mask.relief, camera.sensor
    if not isinstance(relief, RandomLenslets):
        return 0.0
    beyond, pitch = 2 * relief.overhang.um, sensor.pitch.um
    area = math.prod(count * pitch + beyond for count in (sensor.rows, sensor.columns))
    # A place that lenslets are spread on takes twice the memory of a point.
    return area / relief.grid.um**2 + 2 * area * (_STEPS / relief.pitch.um) ** 2


def simulation_bytes(points: float, working: float) -> float:
    """Most memory that a simulation holds: its relief is computed first, and then kept.

    Parameters
    ----------
    points
        Of the relief, as `relief_points` counts them.
    working
        Bytes that the patterns and what is made of them hold.
    """
    return max(surface_bytes(points), working + _BYTES_PER_HEIGHT * points)


def distance_um(distance: Length | str | None, opened: OpenCamera) -> float:
    """A distance as the optics take it: the word is infinity, None the camera's own."""
    if distance is None:
        return opened.camera.reference_distance.um
    return distance.um if isinstance(distance, Length) else math.inf
