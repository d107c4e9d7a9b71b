"""The point nearest to every pixel of a grid, on a torus: one compiled pass on the CPU."""

import importlib
import math

import numpy as np
from numpy.typing import NDArray

from nolens.kernels.threads import for_each_block

_ROWS_PER_BLOCK = 64


def nearest_points(
    points: NDArray[np.float64], shape: tuple[int, int], pitch: float
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Nearest point of every pixel, and its squared distance, on a torus.

    Points are sorted into square bins. A small square of pixels searches rings of bins around
    its middle for the few points that can be nearest to any of its pixels, and compares only them.

    Parameters
    ----------
    points
        (count, 2), rows and columns, within the torus of shape · pitch.
    shape
        (rows, columns) of the grid; pixel (i, j) lies at (i · pitch, j · pitch).
    pitch
        Distance of the pixels, in the unit of the points.

    Returns
    -------
    tuple
        Number of the point, int32, and the squared distance, float32, both of this shape.
    """
    size = np.array(shape, dtype=np.float64) * pitch
    bin_side = math.sqrt(float(size.prod()) / len(points))
    bins = np.maximum(1, (size / bin_side).astype(np.int64))
    place = np.minimum((points / size * bins).astype(np.int64), bins - 1)
    key = place[:, 0] * bins[1] + place[:, 1]
    order = np.argsort(key, kind="stable").astype(np.int32)
    starts = np.searchsorted(key[order], np.arange(int(bins.prod()) + 1)).astype(np.int64)
    owner = np.empty(shape, dtype=np.int32)
    squared = np.empty(shape, dtype=np.float32)
    ordered = points[order]

    on_cpu = importlib.import_module("nolens.kernels.nearest_numba")

    def work(block: int) -> None:
        first = block * _ROWS_PER_BLOCK
        last = min(first + _ROWS_PER_BLOCK, shape[0])
        on_cpu.nearest_rows_(ordered, order, starts, bins, size, pitch, first, last, owner, squared)

    for_each_block(work, -(-shape[0] // _ROWS_PER_BLOCK), shape[0] * shape[1])
    return owner, squared
