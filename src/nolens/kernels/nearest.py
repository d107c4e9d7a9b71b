"""The point nearest to every cell of a grid, on a torus: one compiled pass on the CPU."""

import math

import numba
import numpy as np
from numpy.typing import NDArray

from nolens.kernels.threads import for_each_block

_ROWS_PER_BLOCK = 64


def nearest_points(
    points: NDArray[np.float64], cells: tuple[int, int], pitch: float
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Nearest point of every cell, and its squared distance, on a torus.

    Points are sorted into square bins; a cell looks at rings of bins around its own until no
    nearer point can follow.

    Parameters
    ----------
    points
        (count, 2), rows and columns, within the torus of cells · pitch.
    cells
        (rows, columns) of the grid; cell (i, j) lies at (i · pitch, j · pitch).
    pitch
        Distance of the cells, in the unit of the points.

    Returns
    -------
    tuple
        Number of the point, int32, and the squared distance, float32, both of shape `cells`.
    """
    size = np.array(cells, dtype=np.float64) * pitch
    bin_side = math.sqrt(float(size.prod()) / len(points))
    bins = np.maximum(1, (size / bin_side).astype(np.int64))
    place = np.minimum((points / size * bins).astype(np.int64), bins - 1)
    key = place[:, 0] * bins[1] + place[:, 1]
    order = np.argsort(key, kind="stable").astype(np.int32)
    starts = np.searchsorted(key[order], np.arange(int(bins.prod()) + 1)).astype(np.int64)
    owner = np.empty(cells, dtype=np.int32)
    squared = np.empty(cells, dtype=np.float32)
    ordered = points[order]

    def work(block: int) -> None:
        first = block * _ROWS_PER_BLOCK
        last = min(first + _ROWS_PER_BLOCK, cells[0])
        _rows(ordered, order, starts, bins, size, pitch, first, last, owner, squared)

    for_each_block(work, -(-cells[0] // _ROWS_PER_BLOCK), cells[0] * cells[1])
    return owner, squared


@numba.njit(cache=True, nogil=True)
def _rows(  # type: ignore[no-untyped-def]
    points, order, starts, bins, size, pitch, first, last, owner, squared
):
    side = min(size[0] / bins[0], size[1] / bins[1])
    farthest = max(bins[0], bins[1])
    for i in range(first, last):
        y = i * pitch
        row = min(int(y / size[0] * bins[0]), bins[0] - 1)
        for j in range(owner.shape[1]):
            x = j * pitch
            column = min(int(x / size[1] * bins[1]), bins[1] - 1)
            best = np.inf
            found = -1
            ring = 0
            while ring <= farthest and (found < 0 or best > ((ring - 1) * side) ** 2):
                for a in range(-ring, ring + 1):
                    step = 1 if abs(a) == ring else max(1, 2 * ring)
                    for b in range(-ring, ring + 1, step):
                        cell = ((row + a) % bins[0]) * bins[1] + (column + b) % bins[1]
                        for k in range(starts[cell], starts[cell + 1]):
                            dy = abs(points[k, 0] - y)
                            dx = abs(points[k, 1] - x)
                            dy = min(dy, size[0] - dy)
                            dx = min(dx, size[1] - dx)
                            distance = dy * dy + dx * dx
                            if distance < best:
                                best = distance
                                found = k
                ring += 1
            owner[i, j] = order[found]
            squared[i, j] = best
