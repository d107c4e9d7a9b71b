"""Solids as closed surfaces of triangles: the frame."""

import importlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

import manifold3d as m3
import numpy as np
from numpy.typing import NDArray

from nolens.errors import DataError, OptionError
from nolens.fabricate.frame import FrameGeometry

_BEYOND_MM = 1.0
"""How far what is cut away reaches beyond the faces that it opens."""


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
    """Build the frame, whose middle is at x = y = 0 and which stands on z = 0.

    Parameters
    ----------
    frame
        Its measures.
    title
        See `Solid`.
    """
    height, r = frame.height_mm, frame.rim_mm
    block = m3.CrossSection([outline(frame)]).extrude(height)
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


def outline(frame: FrameGeometry) -> list[tuple[float, float]]:
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
        reach = halves[upright]
        for offset in offsets:
            middle, size = (sign * reach / 2, offset), (reach, frame.vent_width_mm)
            yield (middle[::-1], size[::-1]) if upright else (middle, size)


def _box(
    middle: tuple[float, float], size: tuple[float, float], bottom: float, top: float
) -> m3.Manifold:
    box = m3.Manifold.cube((*size, top - bottom), center=True)
    return box.translate((*middle, (bottom + top) / 2))
