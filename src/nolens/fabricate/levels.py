"""Heights in steps, as the polygons of a layout for lithography."""

import math
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import gdstk
import numpy as np
from numpy.typing import NDArray

from nolens.errors import OptionError
from nolens.fabricate.surface import MadeSurface

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
class Levels:
    r"""A surface in N steps of equal height, the lowest and highest at the surface's own.

    Level k is everything that is at least k steps high: :math:`h ≥ h_{min} + (k - ½)Δ` with
    :math:`Δ = (h_{max} - h_{min})/(N - 1)`. The levels lie within each other like contours on a
    map, and a point's height is :math:`h_{min} + kΔ` with the number k of levels above level 0
    that cover it, at most Δ/2 off. Each is one layer of the layout, as for stacked or repeated
    exposures, each of which adds one step; where a machine wants one dose for each height
    instead, layer k without layer k + 1 is what has exactly k steps.

    Parameters
    ----------
    surface
        The surface.
    count
        N, from 2 to 250.

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
        share = _MOST_BYTES / size
        width, height = (side * math.sqrt(share) for side in self.surface.size_mm)
        most = max(2, 1 + math.floor((self.count - 1) * share))
        raise OptionError(
            f"the layout would have about {size / 1e6:.0f} MB as GDS, more than the "
            f"{_MOST_BYTES / 1e6:.0f} MB that programs read well: {most} levels would fit "
            f"(--levels), or a part of {_down(width)}x{_down(height)}mm (--crop), or a coarser "
            f"--pitch than {self.surface.pitch_um:g}um"
        )

    def polygons(self, tick: Callable[[float], None] | None = None) -> list[list[gdstk.Polygon]]:
        """Trace the levels above 0, in um around the middle, x along the columns, y the rows.

        They are traced in tiles of 500 pixels, at whose seams polygons abut.

        Parameters
        ----------
        tick
            Is told the fraction that is done.

        Returns
        -------
        list
            For each level from 1 on its polygons, whose layer is the level.
        """
        found: list[list[gdstk.Polygon]] = [[] for _ in range(1, self.count)]
        if self.step_um == 0:
            return found
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
                found[level - 1] += [polygon.translate(x, y) for polygon in traced]
            if tick is not None:
                tick((done + 1) / len(tiles))
        return found

    def _tiles(self) -> Iterator[tuple[NDArray[np.float64], tuple[float, float]]]:
        """Pieces that share their edges, with the place of their first point."""
        heights, pitch = self.surface.height_um.numpy(), self.surface.pitch_um
        rows, columns = heights.shape
        for top in range(0, rows - 1, _TILE):
            for left in range(0, columns - 1, _TILE):
                piece = heights[top : top + _TILE + 1, left : left + _TILE + 1]
                place = (left - (columns - 1) / 2) * pitch, (top - (rows - 1) / 2) * pitch
                yield piece.astype(np.float64), place


def _traced(
    tile: NDArray[np.float64], height_um: float, pitch_um: float, level: int
) -> list[gdstk.Polygon]:
    """What of a tile is at least so high; halved where holes are too close to an edge to cut out.

    A single cell has no holes.
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
