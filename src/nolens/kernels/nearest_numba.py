"""The points nearest to rows of a grid: a compiled pass."""

import math

import numba
import numpy as np

_SQUARE = 16
_IMAGES = 16


@numba.njit(cache=True, nogil=True)
def nearest_rows_(  # type: ignore[no-untyped-def]
    points, order, starts, bins, size, pitch, first, last, owner, squared
):
    """Rows of `nolens.kernels.nearest_points`."""
    most = _IMAGES * len(points)
    candidates = np.empty(most, dtype=np.int32)
    at = np.empty((most, 2), dtype=np.float64)
    best = np.empty(_SQUARE, dtype=np.float64)
    who = np.empty(_SQUARE, dtype=np.int32)
    extent = 0.5 * math.sqrt(2.0) * _SQUARE * pitch
    for top in range(first, last, _SQUARE):
        bottom = min(top + _SQUARE, last)
        for left in range(0, owner.shape[1], _SQUARE):
            right = min(left + _SQUARE, owner.shape[1])
            y = 0.5 * (top + bottom - 1) * pitch
            x = 0.5 * (left + right - 1) * pitch
            count = _near(points, starts, bins, size, y, x, extent, candidates, at)
            for i in range(top, bottom):
                best[:] = np.inf
                for k in range(count):
                    dy = at[k, 0] - i * pitch
                    for j in range(right - left):
                        dx = at[k, 1] - (left + j) * pitch
                        distance = dy * dy + dx * dx
                        if distance < best[j]:
                            best[j] = distance
                            who[j] = candidates[k]
                for j in range(right - left):
                    owner[i, left + j] = order[who[j]]
                    squared[i, left + j] = best[j]


@numba.njit(cache=True, nogil=True)
def _near(points, starts, bins, size, y, x, extent, candidates, at):  # type: ignore[no-untyped-def]
    """Points that can be nearest to a place within `extent` of (y, x), moved to its side."""
    side = min(size[0] / bins[0], size[1] / bins[1])
    row = min(int(y / size[0] * bins[0]), bins[0] - 1)
    column = min(int(x / size[1] * bins[1]), bins[1] - 1)
    nearest = np.inf
    count = 0
    ring = 0
    while ring <= max(bins[0], bins[1]) and (ring - 1) * side <= nearest + 2 * extent:
        for a in range(-ring, ring + 1):
            if abs(2 * a) > bins[0] + 1 and ring > 0:
                continue
            step = 1 if abs(a) == ring else max(1, 2 * ring)
            for b in range(-ring, ring + 1, step):
                if abs(2 * b) > bins[1] + 1 and ring > 0:
                    continue
                key = ((row + a) % bins[0]) * bins[1] + (column + b) % bins[1]
                for k in range(starts[key], starts[key + 1]):
                    dy = points[k, 0] - y
                    dx = points[k, 1] - x
                    dy -= size[0] * np.round(dy / size[0])
                    dx -= size[1] * np.round(dx / size[1])
                    # Half a torus away, some pixels are nearer to the point's other image.
                    for m in range(2 if abs(dy) > size[0] / 2 - extent else 1):
                        ey = dy if m == 0 else dy - math.copysign(size[0], dy)
                        for n in range(2 if abs(dx) > size[1] / 2 - extent else 1):
                            ex = dx if n == 0 else dx - math.copysign(size[1], dx)
                            distance = math.sqrt(ey * ey + ex * ex)
                            if distance > nearest + 2 * extent or count == len(candidates):
                                continue
                            nearest = min(nearest, distance)
                            candidates[count] = k
                            at[count, 0] = y + ey
                            at[count, 1] = x + ex
                            count += 1
        ring += 1
    retained = 0
    for k in range(count):
        if math.hypot(at[k, 0] - y, at[k, 1] - x) <= nearest + 2 * extent:
            candidates[retained] = candidates[k]
            at[retained] = at[k]
            retained += 1
    return retained
