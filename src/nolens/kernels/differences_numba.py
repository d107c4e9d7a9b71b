"""The split of differences on the CPU: compiled sweeps over blocks of rows."""

from typing import Any

import numba
import numpy as np
from torch import Tensor

from nolens.kernels.differences import Coupling, Differences, Shrinkage
from nolens.kernels.threads import block_rows, blocks_of, for_each_block

_COLOURS = 3
_FLAGS = {"reassoc", "contract", "nsz"}
_compiled = numba.njit(cache=True, nogil=True, fastmath=_FLAGS, error_model="numpy")
# Python never calls these: what it would call them by takes seconds to compile.
_inlined = numba.njit(  # type: ignore[call-overload]
    fastmath=_FLAGS,
    error_model="numpy",
    forceinline=True,
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)

Floats = np.ndarray[Any, np.dtype[np.float32]]


def shrink_differences_(
    splits: list[Differences],
    shrinkage: Shrinkage,
    kept: float,
    added: float,
    targets: list[Tensor] | None,
    penalty: float,
) -> None:
    """See `nolens.kernels.differences.shrink_differences_`."""
    height, width = splits[0][0].shape
    blocks = blocks_of(height, height * width)
    factors = np.array([kept, added, penalty], np.float32)
    nowhere = np.empty((0, width), np.float32)
    for some in _together(len(splits), shrinkage):
        arrays = _arrays(splits[some])
        pulls = (
            tuple(nowhere for _ in splits[some])
            if targets is None
            else tuple(each.numpy() for each in targets[some])
        )
        last = np.zeros((blocks, len(pulls), width), np.float32)
        limits = _limits(shrinkage)

        def sweep(block: int, arrays: Any = arrays, pulls: Any = pulls, last: Any = last) -> None:
            rows = block_rows(block, blocks, height)
            _shrink_block(arrays, pulls, last[block], factors, limits, rows)  # noqa: B023

        for_each_block(sweep, blocks, height * width)
        if targets is not None:
            # The first row of every block still lacks what comes from the block above it.
            for block in range(blocks):
                start = block_rows((block + 1) % blocks, blocks, height)[0]
                for each, line in zip(pulls, last[block], strict=True):
                    each[start] += line


def add_differences_(split: Differences, scene: Tensor, factor: float) -> None:
    """See `nolens.kernels.differences.add_differences_`."""
    height, width = scene.shape
    blocks = blocks_of(height, height * width)
    down, right = (each.numpy() for each in split)
    plane = scene.numpy()

    def sweep(block: int) -> None:
        rows = block_rows(block, blocks, height)
        _add_block(down, right, plane, np.float32(factor), rows)

    for_each_block(sweep, blocks, height * width)


def difference_sums(
    splits: list[Differences],
    before: list[Differences],
    scenes: list[Tensor],
    shrinkage: Shrinkage,
) -> tuple[list[list[float]], float]:
    """See `nolens.kernels.differences.difference_sums`."""
    height, width = scenes[0].shape
    blocks = blocks_of(height, height * width)
    every, variation = list[list[float]](), 0.0
    limits = _limits(shrinkage)
    for some in _together(len(splits), shrinkage):
        now, then = _arrays(splits[some]), _arrays(before[some])
        planes = tuple(each.numpy() for each in scenes[some])
        sums = np.zeros((blocks, len(planes) + 1, 4))

        def sweep(
            block: int, now: Any = now, then: Any = then, planes: Any = planes, sums: Any = sums
        ) -> None:
            rows = block_rows(block, blocks, height)
            _sum_block(now, then, planes, sums[block], limits, rows)

        for_each_block(sweep, blocks, height * width)
        *of_channels, of_all = sums.sum(axis=0).tolist()
        every += of_channels
        variation += of_all[0]
    return every, variation


def _together(channels: int, shrinkage: Shrinkage) -> list[slice]:
    """Channels of one sweep."""
    if shrinkage.coupling is Coupling.COLOURS:
        return [slice(0, _COLOURS)]
    return [slice(each, each + 1) for each in range(channels)]


def _arrays(splits: list[Differences]) -> tuple[Floats, ...]:
    return tuple(array.numpy() for split in splits for array in split)


def _limits(shrinkage: Shrinkage) -> Floats:
    """Coupling, step, and weights."""
    return np.array([shrinkage.coupling, shrinkage.step, *shrinkage.weights], np.float32)


@_inlined
def _shrunk(arrays, i, limits, u):  # type: ignore[no-untyped-def]
    """Row i of u, (channels · 2, width)."""
    coupling, step = int(limits[0]), limits[1]
    width = u.shape[1]
    if coupling == 0:
        for k in range(len(arrays)):
            a = arrays[k][i]
            for j in range(width):
                u[k, j] = a[j] - min(max(a[j], -step), step)
    elif coupling == 1:
        down, right = arrays[0][i], arrays[1][i]
        for j in range(width):
            length = np.sqrt(down[j] * down[j] + right[j] * right[j])
            factor = np.float32(1) - step / max(length, step)
            u[0, j] = down[j] * factor
            u[1, j] = right[j] * factor
    elif len(arrays) == 6:
        third, half, sixth = _lengths()
        most, red, green = step * limits[2], step * limits[3], step * limits[4]
        for d in range(2):
            x, y, z = arrays[d][i], arrays[2 + d][i], arrays[4 + d][i]
            for j in range(width):
                m = (x[j] + y[j] + z[j]) * third
                r = (x[j] - z[j]) * half
                g = (x[j] - y[j] - y[j] + z[j]) * sixth
                m = (m - min(max(m, -most), most)) * third
                r = (r - min(max(r, -red), red)) * half
                g = (g - min(max(g, -green), green)) * sixth
                u[d, j] = m + r + g
                u[2 + d, j] = m - g - g
                u[4 + d, j] = m - r + g


@_inlined
def _lengths():  # type: ignore[no-untyped-def]
    return (
        np.float32(0.5773502691896258),
        np.float32(0.7071067811865476),
        np.float32(0.4082482904638631),
    )


@_compiled
def _shrink_block(arrays, targets, last, factors, limits, rows):  # type: ignore[no-untyped-def]
    kept, added, penalty = factors
    width = last.shape[1]
    u = np.empty((len(arrays), width), np.float32)
    wanted = len(targets[0]) > 0
    for i in range(rows[0], rows[1]):
        _shrunk(arrays, i, limits, u)
        for c in range(len(targets)):
            down, right = arrays[2 * c][i], arrays[2 * c + 1][i]
            below, after = u[2 * c], u[2 * c + 1]
            if wanted:
                target, flow = targets[c][i], last[c]
                before = penalty * (after[width - 1] + after[width - 1] - right[width - 1])
                for j in range(width):
                    q = penalty * (below[j] + below[j] - down[j])
                    target[j] += (flow[j] if i > rows[0] else np.float32(0)) - q
                    flow[j] = q
                for j in range(1, width):
                    target[j] += penalty * (
                        (after[j - 1] + after[j - 1] - right[j - 1])
                        - (after[j] + after[j] - right[j])
                    )
                target[0] += before - penalty * (after[0] + after[0] - right[0])
            for j in range(width):
                down[j] = kept * down[j] + added * below[j]
                right[j] = kept * right[j] + added * after[j]


@_compiled
def _add_block(down, right, plane, factor, rows):  # type: ignore[no-untyped-def]
    height, width = plane.shape
    for i in range(rows[0], rows[1]):
        v, below = plane[i], plane[(i + 1) % height]
        a, b = down[i], right[i]
        for j in range(width):
            a[j] += factor * (below[j] - v[j])
        for j in range(width - 1):
            b[j] += factor * (v[j + 1] - v[j])
        b[width - 1] += factor * (v[0] - v[width - 1])


@_compiled
def _sum_block(now, then, planes, sums, limits, rows):  # type: ignore[no-untyped-def]
    height, width = planes[0].shape
    count = len(now)
    u, u_then = np.empty((count, width), np.float32), np.empty((count, width), np.float32)
    varied = np.empty((count, width), np.float32)
    for i in range(rows[0], rows[1]):
        _shrunk(now, i, limits, u)
        _shrunk(then, i, limits, u_then)
        for c in range(len(planes)):
            v, below = planes[c][i], planes[c][(i + 1) % height]
            for j in range(width):
                varied[2 * c, j] = below[j] - v[j]
            for j in range(width - 1):
                varied[2 * c + 1, j] = v[j + 1] - v[j]
            varied[2 * c + 1, width - 1] = v[0] - v[width - 1]
        for k in range(count):
            a, a_then = now[k][i], then[k][i]
            x, x_then, moved = u[k], u_then[k], varied[k]
            primal = split = change = turned = np.float32(0)
            for j in range(width):
                primal += (moved[j] - x[j]) * (moved[j] - x[j])
                split += x[j] * x[j]
                step = x[j] - x_then[j]
                change += step * step
                turn = a[j] - a_then[j] - step
                turned += turn * turn
            of = sums[k // 2]
            of[0] += primal
            of[1] += split
            of[2] += change
            of[3] += turned
        sums[len(planes), 0] += _variation(varied, limits)


@_inlined
def _variation(varied, limits):  # type: ignore[no-untyped-def]
    """Of a row's differences, (channels · 2, width)."""
    coupling, width = int(limits[0]), varied.shape[1]
    total = np.float32(0)
    if coupling == 0:
        for k in range(len(varied)):
            for j in range(width):
                total += abs(varied[k, j])
    elif coupling == 1:
        for j in range(width):
            total += np.sqrt(varied[0, j] * varied[0, j] + varied[1, j] * varied[1, j])
    else:
        third, half, sixth = _lengths()
        for d in range(2):
            for j in range(width):
                x, y, z = varied[d, j], varied[2 + d, j], varied[4 + d, j]
                total += limits[2] * abs((x + y + z) * third)
                total += limits[3] * abs((x - z) * half)
                total += limits[4] * abs((x - y - y + z) * sixth)
    return total
