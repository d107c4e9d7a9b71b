"""A measured map of heights as the relief of a camera: its points, its size, its extent."""

import math
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
import torch

from nolens.camera import Flat, LoadedCamera, RandomLenslets, ReliefFile
from nolens.errors import DataError, OptionError
from nolens.optics import Grid, MaskSurface, PointSource, Relief
from nolens.optics.measured import (
    Heights,
    Tilt,
    extend_by_reflection,
    fill_gaps,
    oriented,
    relief_figures,
    remove_tilt,
    resample,
)
from nolens.progress import ProgressCallback
from nolens.quantities import Length
from nolens.twin.model import LARGEST_ANGLE_DEG, Twin, preview_model

_MOST_BAD = 0.05
_MOST_POINTS = 100_000_000
_OVERHANG = 1.25
"""Times the way that the layers move light at the largest angle: what a map is extended beyond."""
_ANGLE_STEPS = 12
_STEP_UM = 20.0


@dataclass(frozen=True)
class MeasuredRelief:
    """A camera with measured heights as its relief.

    Parameters
    ----------
    camera
        The camera.
    tilt
        Of the map before it was taken away.
    bad_points
        Of the map, filled from their neighbours.
    grid
        Distance of the points of the relief.
    extent_deg
        Angles up to which far light falls on all pixels through the relief, along height and
        width; None behind an aperture, which the relief fills.
    relief, before
        Of the camera, and of the one that was described; None where that was flat.
    warnings
        What makes the relief another one than that of the part.
    """

    camera: LoadedCamera
    tilt: Tilt
    bad_points: int
    grid: Length
    extent_deg: list[float] | None
    relief: Relief
    before: Relief | None
    warnings: tuple[str, ...]

    @property
    def figures(self) -> dict[str, Any]:
        """Grid, extent, and the surface beside the described one, in values that JSON has."""
        return {
            "grid_um": self.grid.um,
            "extent_deg": self.extent_deg,
            "measured": _figures(self.relief),
            "described": None if self.before is None else _figures(self.before),
        }


def measured_relief(
    camera: LoadedCamera,
    heights_um: Heights,
    pitch_um: tuple[float, float],
    *,
    file: str,
    source: str,
    grid: Length | None = None,
    mirror: bool = False,
    invert: bool = False,
    turn_deg: int = 0,
    keep_tilt: bool = False,
    tile: bool = False,
    progress: ProgressCallback,
) -> MeasuredRelief:
    """Put a measured map in the place of a camera's relief.

    Parameters
    ----------
    camera
        All but its relief stays.
    heights_um, pitch_um
        The map, NaN where it is not known, and the distances of its rows and columns.
    file, source
        Name of the relief's file, and that of the map, for the camera's name and note.
    grid
        Distance of the points of the relief; None: of the relief so far, or of the pixels.
    mirror, invert, turn_deg
        How the map lies (`oriented`).
    keep_tilt
        Leaves the best-fit plane in.
    tile
        Continues a map that is too small by reflection at its edges.
    progress
        Called with the fraction that is done.

    Raises
    ------
    DataError
        If more than a twentieth of the points is not known.
    OptionError
        If the grid is too fine, or coarser than the light needs, or the map too small.
    """
    warnings = []
    bad = int(np.isnan(heights_um).sum())
    fraction = bad / heights_um.size
    if fraction > _MOST_BAD:
        raise DataError(
            f"{100 * fraction:.2g} % of the points of {source} are marked as bad, more than "
            f"the {100 * _MOST_BAD:g} % that can be filled from their neighbours: measure again, "
            "or cut out a better part"
        )
    if bad:
        warnings.append(
            f"{bad} points of the map ({100 * fraction:.2g} %) are marked as bad: they are filled "
            "from their neighbours"
        )
    heights, pitch_um = oriented(
        heights_um, pitch_um, mirror=mirror, invert=invert, turn_deg=turn_deg
    )
    flat, tilt = remove_tilt(heights, pitch_um)
    heights = fill_gaps(heights if keep_tilt else flat)
    grid = grid or _relief_grid(camera)
    if max(pitch_um) > 1.5 * grid.um:
        warnings.append(
            f"the map has a point every {max(pitch_um):.3g} µm: what is finer on the part is not "
            "in it"
        )
    _check_points(heights.shape, pitch_um, grid)
    heights = resample(heights, pitch_um, grid.um)
    progress(0.5)
    preview = preview_model(camera)
    if tile:
        size_mm = " × ".join(f"{(count - 1) * grid.mm:.3g}" for count in heights.shape)
        points = heights.size
        heights = _extended(heights, preview, grid)
        if heights.size > points:
            warnings.append(
                f"the map of {size_mm} mm is continued by reflection at its edges: the statistics "
                "of the PSF are those of the part, but not its details"
            )
    changed, twin = _with_relief(camera, heights, grid, file=file, source=source)
    return MeasuredRelief(
        changed,
        tilt,
        bad,
        grid,
        _extent_deg(twin),
        twin.mask.relief,
        None if isinstance(camera.camera.mask.relief, Flat) else preview.mask.relief,
        tuple(warnings),
    )


def _figures(relief: Relief) -> dict[str, Any]:
    return {
        key: [round(each, 5) for each in value] if isinstance(value, tuple) else value
        for key, value in asdict(relief_figures(relief)).items()
    }


def _relief_grid(camera: LoadedCamera) -> Length:
    """Distance of the points of a camera's relief, or of its pixels where it has no such points."""
    relief = camera.camera.mask.relief
    if isinstance(relief, RandomLenslets | ReliefFile):
        return relief.grid
    return camera.camera.sensor.pitch


def _extended(heights: Heights, preview: Twin, grid: Length) -> Heights:
    """Reflect a map at its edges until light from all sides passes through it.

    The camera is a preview as `preview_model` gives it. A map that is large enough stays.
    """
    sensor, opening = preview.camera.sensor, preview.mask.opening
    if opening is None:
        farthest = PointSource((0.0, math.tan(math.radians(LARGEST_ANGLE_DEG))))
        beyond = 2 * _OVERHANG * preview.shift_um(farthest)[1]
        sides = [count * sensor.pitch.um + beyond for count in (sensor.rows, sensor.columns)]
    else:
        sides = [side + 4 * grid.um for side in (opening.height_um, opening.width_um)]
    size = (math.ceil(sides[0] / grid.um) + 1, math.ceil(sides[1] / grid.um) + 1)
    _check_points(size, (grid.um, grid.um), grid)
    return extend_by_reflection(heights, size)


def _with_relief(
    camera: LoadedCamera, heights: Heights, grid: Length, *, file: str, source: str
) -> tuple[LoadedCamera, Twin]:
    """The camera with measured heights as its relief, and ready to be simulated."""
    before = camera.camera
    after = before.model_copy(
        update={
            "name": f"{before.name}, relief of {source}",
            "note": f"{before.note} Its relief was measured: {source}.".strip(),
            "mask": before.mask.model_copy(
                update={"relief": ReliefFile(kind="file", file=file, grid=grid)}
            ),
        }
    )
    values = torch.from_numpy(np.ascontiguousarray(heights, dtype=np.float32))
    changed = replace(camera, camera=after, relief_um=values)
    try:
        return changed, Twin.of(changed)
    except OptionError as error:
        raise OptionError(
            f"{error} (--grid). Slopes of a measured map that steep can be its noise: smooth it in "
            "the microscope's software then"
        ) from None


def _extent_deg(twin: Twin) -> list[float] | None:
    """Angles up to which far light falls on all pixels through the relief, along height and width.

    A relief smaller than the aperture, or than light from straight ahead needs, is refused.
    """
    size = twin.mask.relief.extent_um
    size_mm = " × ".join(f"{each * 1e-3:.3g}" for each in size)
    advice = "measure a larger part, or give --tile, which continues it by reflection"
    opening = twin.mask.opening
    if opening is not None:
        if size[0] < opening.height_um or size[1] < opening.width_um:
            raise OptionError(
                f"the map is {size_mm} mm, but the aperture is {opening.height_um * 1e-3:.3g} × "
                f"{opening.width_um * 1e-3:.3g} mm: {advice}"
            )
        return None
    if not _passes(twin, (0.0, 0.0)):
        sensor = twin.camera.sensor
        raise OptionError(
            f"the map is {size_mm} mm, too small for a sensor of {sensor.height_mm:.3g} × "
            f"{sensor.width_mm:.3g} mm and the light that comes to it straight ahead, which pass "
            f"through {_needed_mm(twin)} mm: {advice}"
        )
    return [_widest_deg(twin, axis) for axis in (0, 1)]


def _check_points(shape: tuple[int, ...], pitch_um: tuple[float, float], grid: Length) -> None:
    """Refuse a grid that makes more than 100 million points of a map, or fewer than 2×2."""
    size = [count * step / grid.um for count, step in zip(shape, pitch_um, strict=True)]
    if math.prod(size) > _MOST_POINTS:
        raise OptionError(
            f"a grid of {grid} makes {math.prod(size) / 1e6:.4g} million points of this map: more "
            f"than {_MOST_POINTS // 10**6} million cannot be worked with. Give a coarser --grid, "
            "or a part of the map"
        )
    if min(size) < 2:
        raise OptionError(f"a grid of {grid} is coarser than the map is large: give a finer --grid")


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
    """Largest angle along the height (0) or the width (1) at which light passes, by bisection."""
    low, high = 0.0, LARGEST_ANGLE_DEG
    for _ in range(_ANGLE_STEPS):
        middle = (low + high) / 2
        tangent = math.tan(math.radians(middle))
        passes = _passes(twin, (tangent, 0.0) if axis == 0 else (0.0, tangent))
        low, high = (middle, high) if passes else (low, middle)
    return round(low, 1)


def _passes(twin: Twin, tangent: tuple[float, float]) -> bool:
    """Whether far light of a direction falls on all pixels through the relief."""
    sensor = twin.camera.sensor
    try:
        twin.check_extent(PointSource(tangent), Grid(sensor.rows, sensor.columns, sensor.pitch.um))
    except OptionError:
        return False
    return True
