"""The split of differences on the CPU: compiled sweeps over blocks of rows."""

from typing import Any

import numba
import numpy as np
from torch import Tensor

from nolens.kernels.differences import Shrinkage
from nolens.kernels.threads import block_rows, blocks_of, for_each_block

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


def add_pulls_(targets: Tensor, a: Tensor, shrinkage: Shrinkage, penalty: float) -> None:
    """See `nolens.kernels.differences.add_pulls_`."""
    height, width = a.shape[-2:]
    blocks = blocks_of(height, height * width)
    last = np.zeros((blocks, len(a), width), np.float32)
    arrays, pulls, limits = a.numpy(), targets.numpy(), _limits(shrinkage)

    def sweep(block: int) -> None:
        rows = block_rows(block, blocks, height)
        _pull_block(arrays, pulls, last[block], np.float32(penalty), limits, rows)

    for_each_block(sweep, blocks, a.numel())
    # The first row of every block still lacks what comes from the block above it.
    starts = [block_rows(block, blocks, height)[0] for block in range(blocks)]
    pulls[:, starts] += np.roll(last, 1, axis=0).transpose(1, 0, 2)


def move_differences_(
    a: Tensor, scenes: Tensor, shrinkage: Shrinkage, relaxation: float, *, counted: bool
) -> tuple[list[list[float]], float]:
    """See `nolens.kernels.differences.move_differences_`."""
    height, width = scenes.shape[-2:]
    blocks = blocks_of(height, height * width)
    limits, sums = _limits(shrinkage), np.zeros((blocks, len(a) + 1, 4))
    arrays, planes = a.numpy(), scenes.numpy()

    def sweep(block: int) -> None:
        rows = block_rows(block, blocks, height)
        _move_block(arrays, planes, np.float32(relaxation), counted, sums[block], limits, rows)

    for_each_block(sweep, blocks, a.numel())
    *of_channels, of_all = sums.sum(axis=0).tolist()
    return of_channels, of_all[0]


def scale_multipliers_(a: Tensor, shrinkage: Shrinkage, factor: float) -> None:
    """See `nolens.kernels.differences.scale_multipliers_`."""
    height, width = a.shape[-2:]
    blocks = blocks_of(height, height * width)
    arrays, limits = a.numpy(), _limits(shrinkage)

    def sweep(block: int) -> None:
        _scale_block(arrays, np.float32(factor), limits, block_rows(block, blocks, height))

    for_each_block(sweep, blocks, a.numel())


def _limits(shrinkage: Shrinkage) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Coupling, step, and weights."""
    return np.array([shrinkage.coupling, shrinkage.step, *shrinkage.weights], np.float32)


@_inlined
def _shrunk(a, i, limits, u):  # type: ignore[no-untyped-def]
    """Row i of u, (channels, 2, width)."""
    coupling, step = int(limits[0]), limits[1]
    count, _, width = u.shape
    if coupling == 0:
        for c in range(count):
            for d in range(2):
                for j in range(width):
                    x = a[c, d, i, j]
                    u[c, d, j] = x - min(max(x, -step), step)
    elif coupling == 1:
        for c in range(count):
            for j in range(width):
                down, right = a[c, 0, i, j], a[c, 1, i, j]
                length = np.sqrt(down * down + right * right)
                factor = np.float32(1) - step / max(length, step)
                u[c, 0, j] = down * factor
                u[c, 1, j] = right * factor
    else:
        third, half, sixth = _lengths()
        most, red, green = step * limits[2], step * limits[3], step * limits[4]
        for d in range(2):
            for j in range(width):
                x, y, z = a[0, d, i, j], a[1, d, i, j], a[2, d, i, j]
                m = (x + y + z) * third
                r = (x - z) * half
                g = (x - y - y + z) * sixth
                m = (m - min(max(m, -most), most)) * third
                r = (r - min(max(r, -red), red)) * half
                g = (g - min(max(g, -green), green)) * sixth
                u[0, d, j] = m + r + g
                u[1, d, j] = m - g - g
                u[2, d, j] = m - r + g


@_inlined
def _lengths():  # type: ignore[no-untyped-def]
    return (
        np.float32(0.5773502691896258),
        np.float32(0.7071067811865476),
        np.float32(0.4082482904638631),
    )


@_compiled
def _pull_block(a, targets, last, penalty, limits, rows):  # type: ignore[no-untyped-def]
    count, width = last.shape
    u = np.empty((count, 2, width), np.float32)
    for i in range(rows[0], rows[1]):
        _shrunk(a, i, limits, u)
        for c in range(count):
            down, right = a[c, 0, i], a[c, 1, i]
            below, after = u[c, 0], u[c, 1]
            target, flow = targets[c, i], last[c]
            for j in range(width):
                q = penalty * (below[j] + below[j] - down[j])
                target[j] += flow[j] - q
                flow[j] = q
            end = after[width - 1] + after[width - 1] - right[width - 1]
            target[0] += penalty * (end - (after[0] + after[0] - right[0]))
            for j in range(1, width):
                before = after[j - 1] + after[j - 1] - right[j - 1]
                target[j] += penalty * (before - (after[j] + after[j] - right[j]))


@_compiled
def _scale_block(a, factor, limits, rows):  # type: ignore[no-untyped-def]
    count, _, _, width = a.shape
    u = np.empty((count, 2, width), np.float32)
    for i in range(rows[0], rows[1]):
        _shrunk(a, i, limits, u)
        for c in range(count):
            for d in range(2):
                row, x = a[c, d, i], u[c, d]
                for j in range(width):
                    row[j] = x[j] + factor * (row[j] - x[j])


@_compiled
def _move_block(  # type: ignore[no-untyped-def]
    a, planes, relaxation, counted, sums, limits, rows
):
    count, height, width = planes.shape
    u, varied = np.empty((2, count, 2, width), np.float32), np.empty((count, 2, width), np.float32)
    multiplier = np.empty((count, 2, width), np.float32)
    for i in range(rows[0], rows[1]):
        _shrunk(a, i, limits, u[0])
        for c in range(count):
            v, under = planes[c, i], planes[c, (i + 1) % height]
            for j in range(width):
                varied[c, 0, j] = under[j] - v[j]
            for j in range(width - 1):
                varied[c, 1, j] = v[j + 1] - v[j]
            varied[c, 1, width - 1] = v[0] - v[width - 1]
            for d in range(2):
                row, x, moved, d_then = a[c, d, i], u[0, c, d], varied[c, d], multiplier[c, d]
                for j in range(width):
                    d_then[j] = row[j] - x[j]
                    row[j] += relaxation * (moved[j] - x[j])
        if not counted:
            continue
        _shrunk(a, i, limits, u[1])
        for c in range(count):
            for d in range(2):
                row, moved, d_then = a[c, d, i], varied[c, d], multiplier[c, d]
                x_then, x = u[0, c, d], u[1, c, d]
                primal = split = change = turned = np.float32(0)
                for j in range(width):
                    primal += (moved[j] - x[j]) * (moved[j] - x[j])
                    split += x[j] * x[j]
                    step = x[j] - x_then[j]
                    change += step * step
                    turn = row[j] - x[j] - d_then[j]
                    turned += turn * turn
                sums[c, 0] += primal
                sums[c, 1] += split
                sums[c, 2] += change
                sums[c, 3] += turned
        sums[count, 0] += _variation(varied, limits)


@_inlined
def _variation(varied, limits):  # type: ignore[no-untyped-def]
    """Of a row's differences, (channels, 2, width)."""
    coupling, (count, _, width) = int(limits[0]), varied.shape
    total = np.float32(0)
    if coupling == 0:
        for c in range(count):
            for d in range(2):
                for j in range(width):
                    total += abs(varied[c, d, j])
    elif coupling == 1:
        for c in range(count):
            for j in range(width):
                down, right = varied[c, 0, j], varied[c, 1, j]
                total += np.sqrt(down * down + right * right)
    else:
        third, half, sixth = _lengths()
        for d in range(2):
            for j in range(width):
                x, y, z = varied[0, d, j], varied[1, d, j], varied[2, d, j]
                total += limits[2] * abs((x + y + z) * third)
                total += limits[3] * abs((x - z) * half)
                total += limits[4] * abs((x - y - y + z) * sixth)
    return total
