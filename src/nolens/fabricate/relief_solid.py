"""The relief as a solid: its surface on a flat base."""

import math

import numpy as np
from numpy.typing import NDArray

from nolens.errors import OptionError
from nolens.fabricate.solid import Solid
from nolens.fabricate.surface import MadeSurface


def decimated(surface: MadeSurface, triangles: int) -> MadeSurface:
    """Thin a surface out until its solid has no more than so many triangles.

    Over m × n points a solid has 2(m−1)(n−1) triangles on top and 6(m+n−2) at its sides and
    its base.

    Parameters
    ----------
    surface
        All points.
    triangles
        The most that are wanted.

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
    The flat base is at z = 0, and the surface's lowest point at z = `base_mm`.

    Parameters
    ----------
    surface
        Its points become vertices; each square of four is halved along the same diagonal.
    base_mm
        Thickness under the lowest point.

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


def _around(index: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points of the edge, counter-clockwise."""
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])
