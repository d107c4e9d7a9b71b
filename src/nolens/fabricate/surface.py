"""The surface that is made of the relief, and its levels as polygons for lithography."""

import math
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import gdstk
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.errors import OptionError
from nolens.optics import Grid, Relief
from nolens.progress import ProgressCallback, part_of

SurfaceName = Literal["master", "mould", "replica"]
_STRIP = 256
_WORDS: dict[SurfaceName, str] = {
    "master": "MASTER: as on the camera, towards the viewer",
    "mould": "MOULD: mirrored left-right and inverted, towards the viewer",
    "replica": "REPLICA: as on the camera, towards the scene",
}
MOST_LEVELS = 250
_TILE = 500
_PRECISION_UM = 1e-6
"""Of the vertices; coarser, holes next to an edge come to touch it."""
_LARGEST_UM = 2**31 * 1e-3 / 2
"""In the files' steps of 1 nm."""
_BYTES = {"GDS": 8.1, "OASIS": 3.2}
"""For one vertex; measured with the paper's mask."""
_MOST_BYTES = 500e6


@dataclass(frozen=True)
class MadeSurface:
    """Heights of a surface that is to be made, as they appear to who looks onto it.

    Parameters
    ----------
    name
        Which one it is.
    camera
        Name of the camera.
    height_um
        float32, (rows, columns), towards the viewer. Columns go to the right and rows *upwards*:
        so the sensor's go for who looks at the camera from the scene, because the sensor's
        picture is upright (`nolens.optics.PointSource.origin_um`).
    pitch_um
        Distance of the points, in both directions.
    rms_error_um, largest_error_um
        By how much the surface between the remaining points misses the relief's own points.
    """

    name: SurfaceName
    camera: str
    height_um: Tensor
    pitch_um: float
    rms_error_um: float = 0.0
    largest_error_um: float = 0.0

    @property
    def words(self) -> str:
        """Which surface it is, in ASCII, as all files of it say."""
        return _WORDS[self.name]

    @property
    def size_mm(self) -> tuple[float, float]:
        """(width, height) from the first point to the last one."""
        rows, columns = self.height_um.shape
        return (columns - 1) * self.pitch_um * 1e-3, (rows - 1) * self.pitch_um * 1e-3

    @property
    def range_um(self) -> tuple[float, float]:
        """Lowest and highest point."""
        return float(self.height_um.min()), float(self.height_um.max())

    def coarser(self, pitch_um: float) -> "MadeSurface":
        """The surface at points farther apart, by cubic interpolation (`Relief.sample`).

        Raises
        ------
        OptionError
            If they are nearer than they were, or fewer than 2×2 are left.
        """
        if pitch_um < self.pitch_um * (1 - 1e-9):
            raise OptionError(
                f"a pitch of {pitch_um:g} µm is finer than the relief's {self.pitch_um:g} µm, and "
                f"would add nothing: give {self.pitch_um:g} µm or more (--pitch), or a camera "
                "whose relief has a finer grid"
            )
        count = [math.floor(length * 1e3 / pitch_um + 1e-6) + 1 for length in self.size_mm[::-1]]
        if min(count) < 2:
            raise OptionError(
                f"a pitch of {pitch_um:g} µm leaves fewer than 2×2 points of a relief of "
                f"{self.size_mm[0]:.4g} × {self.size_mm[1]:.4g} mm: give a smaller one (--pitch)"
            )
        if count == list(self.height_um.shape):
            return self
        relief = Relief(self.height_um, self.pitch_um)
        coarse = relief.sample(Grid(count[0], count[1], pitch_um))
        squares, largest, points = 0.0, 0.0, 0
        for made, meant in _beside(coarse, pitch_um, self):
            miss = (made - meant).double()
            squares, points = squares + float(miss.square().sum()), points + miss.numel()
            largest = max(largest, float(miss.abs().max()))
        return replace(
            self,
            height_um=coarse,
            pitch_um=pitch_um,
            rms_error_um=math.sqrt(squares / points),
            largest_error_um=largest,
        )


def made_surface(
    relief: Relief,
    name: SurfaceName,
    camera: str,
    *,
    crop_mm: tuple[float, float] | None = None,
    mould_shrinkage: float = 0.0,
) -> MadeSurface:
    r"""Turn the relief on a camera into the surface that is made.

    The replica is the relief h(x, y) itself. The mould meets it from above; turned over, it shows
    :math:`-h(-x, y)`. The mould took its shape from the master while it was larger, by
    :math:`1/(1 - s)` with the linear shrinkage s, so the master is the replica enlarged by that in
    all directions (`lee2008` gives s for PDMS).

    Parameters
    ----------
    relief
        On the camera.
    name, camera
        Which surface, and the name of the camera.
    crop_mm
        (width, height) of the middle part that is made; None for all of it.
    mould_shrinkage
        Fraction of its lengths that the mould loses until it is used.

    Raises
    ------
    OptionError
        If the part is larger than the relief, or smaller than 2×2 points, or the shrinkage is
        not within 0 to 0.5.
    """
    if not 0 <= mould_shrinkage < 0.5:
        raise OptionError(
            f"a shrinkage of the mould of {100 * mould_shrinkage:g} % (--mould-shrinkage): give a "
            "fraction of the length from 0 % to less than 50 %"
        )
    heights = relief.height_um
    if crop_mm is not None:
        heights = _cropped(relief, crop_mm)
    pitch_um = relief.grid_um
    if name == "mould":
        heights = -heights.flip(1)
    elif name == "master":
        heights, pitch_um = heights / (1 - mould_shrinkage), pitch_um / (1 - mould_shrinkage)
    return MadeSurface(name, camera, heights.contiguous(), pitch_um)


@dataclass(frozen=True)
class Levels:
    r"""A surface in N steps of equal height, the lowest and highest at the surface's own.

    Level k is everything that is at least k steps high: :math:`h ≥ h_{min} + (k - ½)Δ` with
    :math:`Δ = (h_{max} - h_{min})/(N - 1)`. The levels lie within each other like contours on a
    map, and a point's height is :math:`h_{min} + kΔ` with the number k of levels above level 0
    that cover it, at most Δ/2 off. Each is one layer of the layout, as for stacked or repeated
    exposures, each of which adds one step; where a machine wants one dose for each height
    instead, layer k without layer k + 1 is what has exactly k steps.

    Raises
    ------
    OptionError
        If there are fewer or more levels than that, or the surface is larger than a layout.
    """

    surface: MadeSurface
    count: int

    def __post_init__(self) -> None:
        if not 2 <= self.count <= MOST_LEVELS:
            raise OptionError(
                f"{self.count} levels (--levels): give 2 to {MOST_LEVELS}; each is a layer of the "
                "layout"
            )
        largest = max(self.surface.size_mm) * 1e3
        if largest > _LARGEST_UM:
            raise OptionError(
                f"a mask of {largest * 1e-3:.4g} mm is larger than GDSII holds in steps of 1 nm, "
                f"{_LARGEST_UM * 1e-3:.0f} mm: give a --crop of at most that"
            )

    @property
    def step_um(self) -> float:
        """Height Δ of a step."""
        low, high = self.surface.range_um
        return (high - low) / (self.count - 1)

    def height_um(self, level: int) -> float:
        """Height of a level's terrace."""
        return self.surface.range_um[0] + level * self.step_um

    @cached_property
    def vertices(self) -> int:
        """About how many vertices the polygons have: one for each step between neighbours."""
        if self.step_um == 0:
            return 0
        total = 0
        for tile, _ in self._tiles():
            steps = np.floor((tile - self.surface.range_um[0]) / self.step_um + 0.5)
            total += int(sum(np.abs(np.diff(steps, axis=axis)).sum() for axis in (0, 1)))
        return total

    def expected_bytes(self, kind: str) -> float:
        """About how large the file will be, of kind GDS or OASIS."""
        return self.vertices * _BYTES[kind]

    def check_size(self) -> None:
        """Refuse a layout too large for most programs that read it.

        Raises
        ------
        OptionError
            If the GDS would have more than 500 MB; says what would fit.
        """
        size = self.expected_bytes("GDS")
        if size <= _MOST_BYTES:
            return
        fraction = _MOST_BYTES / size
        width, height = (side * math.sqrt(fraction) for side in self.surface.size_mm)
        most = max(2, 1 + math.floor((self.count - 1) * fraction))
        raise OptionError(
            f"the layout would have about {size / 1e6:.0f} MB as GDS, more than the "
            f"{_MOST_BYTES / 1e6:.0f} MB that programs read well: {most} levels would fit "
            f"(--levels), or a part of {_down(width)}x{_down(height)}mm (--crop), or a coarser "
            f"--pitch than {self.surface.pitch_um:g}um"
        )

    def polygons(self, progress: ProgressCallback | None = None) -> list[list[gdstk.Polygon]]:
        """Trace the levels above 0, in um around the middle, x along the columns, y the rows.

        They are traced in tiles of 500 pixels, at whose seams polygons abut. The list has those
        of each level from 1 on, whose layer is the level.
        """
        levels: list[list[gdstk.Polygon]] = [[] for _ in range(1, self.count)]
        if self.step_um == 0:
            return levels
        tiles = list(self._tiles())
        low, pitch = self.surface.range_um[0], self.surface.pitch_um
        for done, (tile, (x, y)) in enumerate(tiles):
            lowest, highest = float(tile.min()), float(tile.max())
            for level in range(1, self.count):
                at = low + (level - 0.5) * self.step_um
                if highest < at:
                    break
                if lowest >= at:
                    size = (tile.shape[1] - 1) * pitch, (tile.shape[0] - 1) * pitch
                    traced = [gdstk.rectangle((0, 0), size, layer=level)]
                else:
                    traced = _traced(tile, at, pitch, level)
                levels[level - 1] += [polygon.translate(x, y) for polygon in traced]
            part_of(progress, done, len(tiles))(1.0)
        return levels

    def _tiles(self) -> Iterator[tuple[NDArray[np.float64], tuple[float, float]]]:
        """Pieces that share their edges, with the place of their first point."""
        heights, pitch = self.surface.height_um.numpy(), self.surface.pitch_um
        rows, columns = heights.shape
        for top in range(0, rows - 1, _TILE):
            for left in range(0, columns - 1, _TILE):
                piece = heights[top : top + _TILE + 1, left : left + _TILE + 1]
                place = (left - (columns - 1) / 2) * pitch, (top - (rows - 1) / 2) * pitch
                yield piece.astype(np.float64), place


def _cropped(relief: Relief, crop_mm: tuple[float, float]) -> Tensor:
    whole = relief.extent_um[::-1]
    if any(not 0 < part * 1e3 <= all_ + 1e-6 for part, all_ in zip(crop_mm, whole, strict=True)):
        raise OptionError(
            f"a crop of {crop_mm[0]:g} × {crop_mm[1]:g} mm is no part of the relief of "
            f"{whole[0] * 1e-3:.4g} × {whole[1] * 1e-3:.4g} mm: give at most that (--crop)"
        )
    slices = []
    for side, count in zip(crop_mm[::-1], relief.height_um.shape, strict=True):
        points = math.floor(side * 1e3 / relief.grid_um + 1e-6) + 1
        # The middle must stay where it is.
        points -= (count - points) % 2
        if points < 2:
            raise OptionError(
                f"a crop of {crop_mm[0]:g} × {crop_mm[1]:g} mm has fewer than 2×2 points of the "
                f"relief, which has one every {relief.grid_um:g} µm: give a larger one (--crop)"
            )
        first = (count - points) // 2
        slices.append(slice(first, first + points))
    return relief.height_um[slices[0], slices[1]]


def _beside(coarse: Tensor, pitch_um: float, fine: MadeSurface) -> Iterator[tuple[Tensor, Tensor]]:
    """Heights between the points of a coarser grid (bilinear), and the surface's own, in strips."""
    (top, rows, down), (left, columns, right) = (
        _interpolation(fine.height_um.shape[axis], fine.pitch_um, coarse.shape[axis], pitch_um)
        for axis in (0, 1)
    )
    inside = slice(left, left + len(columns))
    for start in range(0, len(rows), _STRIP):
        part = slice(start, start + _STRIP)
        at, fraction = rows[part], down[part, None]
        lines = coarse[at] * (1 - fraction) + coarse[at + 1] * fraction
        made = lines[:, columns] * (1 - right) + lines[:, columns + 1] * right
        yield made, fine.height_um[top + start : top + start + len(at), inside]


def _interpolation(
    count: int, pitch_um: float, coarse_count: int, coarse_pitch_um: float
) -> tuple[int, Tensor, Tensor]:
    """First fine point within the coarse grid; interval and place in it of each from there."""
    steps = torch.arange(count, dtype=torch.float64) - (count - 1) / 2
    place = steps * (pitch_um / coarse_pitch_um) + (coarse_count - 1) / 2
    within = torch.nonzero((place >= -1e-9) & (place <= coarse_count - 1 + 1e-9))[:, 0]
    place = place[within]
    interval = place.floor().clamp(0, coarse_count - 2)
    return int(within[0]), interval.long(), (place - interval).float()


def _traced(
    tile: NDArray[np.float64], height_um: float, pitch_um: float, level: int
) -> list[gdstk.Polygon]:
    """What of a tile is at least so high; halved where holes are too close to an edge to cut out.

    A single square of four points has no holes.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)
            # gdstk's stub takes whole numbers alone; its text says a number.
            return gdstk.contour(
                tile,
                height_um,  # type: ignore[arg-type]
                length_scale=pitch_um,
                precision=_PRECISION_UM,
                layer=level,
            )
    except RuntimeWarning:
        long = int(tile.shape[1] >= tile.shape[0])
        half = tile.shape[long] // 2
        parts = (tile[:, : half + 1], tile[:, half:]) if long else (tile[: half + 1], tile[half:])
        shift = (half * pitch_um, 0.0) if long else (0.0, half * pitch_um)
        one, other = (_traced(part, height_um, pitch_um, level) for part in parts)
        return one + [polygon.translate(*shift) for polygon in other]


def _down(length_mm: float) -> str:
    return f"{math.floor(length_mm * 10) / 10:g}"
