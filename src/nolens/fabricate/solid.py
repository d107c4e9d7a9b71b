"""Solids as closed surfaces of triangles: the frame, and the relief on a flat base."""

import importlib
import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import manifold3d as m3
import numpy as np
from numpy.typing import NDArray

from nolens.errors import DataError, OptionError
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.surface import MadeSurface

_BEYOND_MM = 1.0
"""How far what is cut away extends beyond the faces that it opens."""


@dataclass(frozen=True)
class Solid:
    """A solid by its surface.

    Parameters
    ----------
    vertices_mm
        float64, (points, 3).
    triangles
        int64, (triangles, 3): each names three vertices, counter-clockwise seen from outside.
    title
        What it is, and which surface, in ASCII; files carry it.
    """

    vertices_mm: NDArray[np.float64]
    triangles: NDArray[np.int64]
    title: str

    @property
    def volume_mm3(self) -> float:
        """Volume, by the divergence theorem: a sixth of Σ a · (b × c) over the triangles."""
        a, b, c = (self.vertices_mm[self.triangles[:, corner]] for corner in range(3))
        return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)

    def check_closed(self) -> None:
        """Make sure that the surface is closed, so that it has an inside.

        Raises
        ------
        DataError
            If it is not; no file should be made of it.
        """
        # Its import takes as long as all else of the command line; no other command needs it.
        trimesh = importlib.import_module("trimesh")
        mesh = trimesh.Trimesh(self.vertices_mm, self.triangles, process=False)
        if not mesh.is_volume:
            raise DataError(
                f"the surface of {self.title!r} is not closed, and is no solid: its measures are "
                "too far apart; choose larger ones for its smallest parts"
            )

    def grown(self, shrinkage: float) -> "Solid":
        """The solid to make of a material that shrinks in all lengths by a fraction.

        Raises
        ------
        OptionError
            If the fraction is not within 0 to 0.5.
        """
        if not 0 <= shrinkage < 0.5:
            raise OptionError(
                f"a shrinkage of {100 * shrinkage:g} %: give a fraction of the length from 0 % to "
                "less than 50 %"
            )
        return replace(self, vertices_mm=self.vertices_mm / (1 - shrinkage))


def frame_solid(frame: FrameGeometry, title: str) -> Solid:
    """Build the frame, whose middle is at x = y = 0 and which stands on z = 0."""
    height, r = frame.height_mm, frame.rim_mm
    block = m3.CrossSection([frame_corners(frame)]).extrude(height)
    inner = frame.inner_width_mm, frame.inner_height_mm
    cut = [_box((0, 0), inner, -_BEYOND_MM, height + _BEYOND_MM)]
    if r > 0:
        corners = [
            (sx * (inner[0] / 2 + grown), sy * (inner[1] / 2 + grown), height - r + up)
            for grown, up in ((0.0, 0.0), (r + _BEYOND_MM, r + _BEYOND_MM))
            for sx in (-1, 1)
            for sy in (-1, 1)
        ]
        cut.append(m3.Manifold.hull_points(np.array(corners)))
    floor = height - frame.vent_depth_mm
    cut.extend(_box(*vent, floor, height + _BEYOND_MM) for vent in vent_boxes(frame))
    made = block - m3.Manifold.batch_boolean(cut, m3.OpType.Add)
    mesh = made.to_mesh64()
    return Solid(
        np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3],
        np.asarray(mesh.tri_verts, dtype=np.int64),
        title,
    )


def decimated(surface: MadeSurface, triangles: int) -> MadeSurface:
    """Thin a surface out until its solid has no more than so many triangles.

    Over m × n points a solid has 2(m−1)(n−1) triangles on top and 6(m+n−2) at its sides and
    its base.

    Raises
    ------
    OptionError
        If so few triangles make no solid.
    """
    if triangles < 1:
        raise OptionError(f"{triangles} triangles (--triangles): give more, such as 500000")
    rows, columns = (count - 1 for count in surface.height_um.shape)
    if 2 * rows * columns + 6 * (rows + columns) <= triangles:
        return surface
    # The steps r/k and c/k with 2rc/k² + 6(r+c)/k = most give k; whole steps are not more.
    half = 3 * (rows + columns)
    factor = (half + math.sqrt(half * half + 2 * rows * columns * triangles)) / triangles
    shorter = min(rows, columns)
    if factor > shorter:
        fewest = 2 * (max(rows, columns) // shorter) + 6 * (max(rows, columns) // shorter + 1)
        raise OptionError(
            f"{triangles} triangles (--triangles) make no relief of {surface.size_mm[0]:.4g} × "
            f"{surface.size_mm[1]:.4g} mm: give {fewest} or more, such as 500000"
        )
    return surface.coarser(surface.pitch_um * factor)


def relief_solid(surface: MadeSurface, base_mm: float) -> Solid:
    """Build the solid below a surface.

    Seen from above, x goes along the columns and y along the rows; the middle is at x = y = 0.
    The flat base is at z = 0, and the surface's lowest point at z = `base_mm`. The points become
    vertices; each square of four is halved along the same diagonal.

    Raises
    ------
    OptionError
        If the base has no thickness.
    """
    if not 0 < base_mm < math.inf:
        raise OptionError(f"a base of {base_mm:g} mm (--base): it must be more than 0 mm")
    heights = surface.height_um.double().numpy()
    rows, columns = heights.shape
    x, y = (
        (np.arange(count) - (count - 1) / 2) * surface.pitch_um * 1e-3 for count in (columns, rows)
    )
    top = np.empty((rows, columns, 3))
    top[..., 0], top[..., 1] = x, y[:, None]
    top[..., 2] = base_mm + (heights - heights.min()) * 1e-3
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    upper = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    edge = _around(index)
    foot = top.reshape(-1, 3)[edge] * (1, 1, 0)
    first, middle = rows * columns, rows * columns + len(edge)
    below = np.arange(first, middle)
    following, under = np.roll(edge, -1), np.roll(below, -1)
    sides = np.concatenate(
        [np.stack([edge, below, under], -1), np.stack([edge, under, following], -1)]
    )
    base = np.stack([under, below, np.full_like(below, middle)], -1)
    return Solid(
        np.concatenate([top.reshape(-1, 3), foot, np.zeros((1, 3))]),
        np.concatenate([upper, sides, base]),
        f"{surface.words}; relief of {surface.camera}",
    )


def frame_corners(frame: FrameGeometry) -> list[tuple[float, float]]:
    """Corners of the frame's outside, counter-clockwise; the one at pixel (0, 0) is cut off."""
    x, y, mark = frame.outer_width_mm / 2, frame.outer_height_mm / 2, frame.mark_mm
    cut = [(-x, -y + mark), (-x + mark, -y)] if mark > 0 else [(-x, -y)]
    return [*cut, (x, -y), (x, y), (-x, y)]


def vent_boxes(
    frame: FrameGeometry,
) -> Iterator[tuple[tuple[float, float], tuple[float, float]]]:
    """Middle and size (x, y) of boxes that cut the vents, from the cavity's middle to outside."""
    halves = frame.outer_width_mm / 2 + _BEYOND_MM, frame.outer_height_mm / 2 + _BEYOND_MM
    for side, offsets in enumerate(frame.vent_offsets_mm()):
        upright, sign = side >= 2, 1 - 2 * (side % 2)
        length = halves[upright]
        for offset in offsets:
            middle, size = (sign * length / 2, offset), (length, frame.vent_width_mm)
            yield (middle[::-1], size[::-1]) if upright else (middle, size)


def _box(
    middle: tuple[float, float], size: tuple[float, float], bottom: float, top: float
) -> m3.Manifold:
    box = m3.Manifold.cube((*size, top - bottom), center=True)
    return box.translate((*middle, (bottom + top) / 2))


def _around(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points of the edge, counter-clockwise."""
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
