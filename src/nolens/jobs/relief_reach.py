"""How far a measured relief reaches, and its continuation where it ends too early."""

import math
from dataclasses import replace

import torch

from nolens.errors import OptionError
from nolens.optics import Grid, MaskSurface, PointSource, Relief
from nolens.optics.measured import Heights, mirrored_on
from nolens.quantities import Length
from nolens.twin import LARGEST_ANGLE_DEG, Twin

_LARGEST = 100_000_000
_OVERHANG = 1.25
"""Times the way that the layers move light at the largest angle: what is continued beyond."""
_ANGLE_STEPS = 12
_STEP_UM = 20.0


def check_points(shape: tuple[int, ...], pitch_um: tuple[float, float], grid: Length) -> None:
    """Refuse a grid that makes too many points of a map, or too few.

    Parameters
    ----------
    shape
        Rows and columns of the map.
    pitch_um
        Distance of its points.
    grid
        Distance of the points of the relief.

    Raises
    ------
    OptionError
        If there are more than 100 million, or fewer than 2 along a side.
    """
    size = [count * step / grid.um for count, step in zip(shape, pitch_um, strict=True)]
    if math.prod(size) > _LARGEST:
        raise OptionError(
            f"a grid of {grid} makes {math.prod(size) / 1e6:.4g} million points of this map: more "
            f"than {_LARGEST // 10**6} million cannot be worked with. Give a coarser --grid, or a "
            "part of the map"
        )
    if min(size) < 2:
        raise OptionError(f"a grid of {grid} is coarser than the map is large: give a finer --grid")


def continued(heights: Heights, bare: Twin, grid: Length, warnings: list[str]) -> Heights:
    """Reflect a map at its edges until light from all sides passes through it.

    Parameters
    ----------
    heights
        (rows, columns).
    bare
        The camera.
    grid
        Distance of the points.
    warnings
        Gets what a person must know of it.

    Raises
    ------
    OptionError
        If that is more points than can be worked with.
    """
    sensor = bare.camera.sensor
    sides = (sensor.rows * sensor.pitch.um, sensor.columns * sensor.pitch.um)
    shift = bare.shift_um(PointSource((0.0, math.tan(math.radians(LARGEST_ANGLE_DEG)))))[1]
    wanted = [side + 2 * _OVERHANG * shift for side in sides]
    opening = bare.mask.opening
    if opening is not None:
        wanted = [opening.height_um + 4 * grid.um, opening.width_um + 4 * grid.um]
    size = (math.ceil(wanted[0] / grid.um) + 1, math.ceil(wanted[1] / grid.um) + 1)
    check_points(size, (grid.um, grid.um), grid)
    if size[0] <= heights.shape[0] and size[1] <= heights.shape[1]:
        return heights
    was = " × ".join(f"{(count - 1) * grid.mm:.3g}" for count in heights.shape)
    warnings.append(
        f"the map of {was} mm is continued by reflection at its edges: the statistics of the "
        "pattern are those of the part, but not its details"
    )
    return mirrored_on(heights, size)


def reach_deg(twin: Twin) -> list[float] | None:
    """Angles up to which far light reaches all pixels through the relief.

    Parameters
    ----------
    twin
        The camera with the measured relief.

    Returns
    -------
    list
        Along the height and along the width, in degrees; None behind an aperture, which the
        relief fills.

    Raises
    ------
    OptionError
        If the relief is smaller than the aperture, or than light from straight ahead needs.
    """
    extent = twin.mask.relief.extent_um
    was = " × ".join(f"{each * 1e-3:.3g}" for each in extent)
    advice = "measure a larger part, or give --tile, which continues it by reflection"
    opening = twin.mask.opening
    if opening is not None:
        if extent[0] < opening.height_um or extent[1] < opening.width_um:
            raise OptionError(
                f"the map is {was} mm, but the aperture is {opening.height_um * 1e-3:.3g} × "
                f"{opening.width_um * 1e-3:.3g} mm: {advice}"
            )
        return None
    if not _passes(twin, (0.0, 0.0)):
        sensor = twin.camera.sensor
        raise OptionError(
            f"the map is {was} mm, too small for a sensor of {sensor.height_mm:.3g} × "
            f"{sensor.width_mm:.3g} mm and the light that comes to it straight ahead, which pass "
            f"through {_needed_mm(twin)} mm: {advice}"
        )
    return [_widest_deg(twin, axis) for axis in (0, 1)]


def _needed_mm(twin: Twin) -> str:
    """Height and width of a relief with such slopes that light from straight ahead needs."""
    sensor = twin.camera.sensor
    beyond = 0.0
    while True:
        beyond += _STEP_UM
        sides = [count * sensor.pitch.um + 2 * beyond for count in (sensor.rows, sensor.columns)]
        # Only its size and its steepest slope count.
        heights = torch.zeros(*(math.ceil(side / _STEP_UM) for side in sides))
        heights[0, 0] = twin.mask.relief.steepest * _STEP_UM
        trial = replace(twin, mask=MaskSurface(Relief(heights, _STEP_UM)))
        if _passes(trial, (0.0, 0.0)):
            return " × ".join(f"{side * 1e-3:.3g}" for side in sides)


def _widest_deg(twin: Twin, axis: int) -> float:
    low, high = 0.0, LARGEST_ANGLE_DEG
    for _ in range(_ANGLE_STEPS):
        middle = (low + high) / 2
        tangent = math.tan(math.radians(middle))
        passes = _passes(twin, (tangent, 0.0) if axis == 0 else (0.0, tangent))
        low, high = (middle, high) if passes else (low, middle)
    return round(low, 1)


def _passes(twin: Twin, tangent: tuple[float, float]) -> bool:
    """Whether far light of a direction reaches all pixels through the relief."""
    sensor = twin.camera.sensor
    try:
        twin.check_extent(PointSource(tangent), Grid(sensor.rows, sensor.columns, sensor.pitch.um))
    except OptionError:
        return False
    return True
