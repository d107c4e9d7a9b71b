"""CPU passes of ADMM: one sweep over memory each, compiled by numba.

The update sweeps blocks of rows. Within a block a row's pair (v, Mv) is read, its splits are
updated and the pair is overwritten; only the first row of the following block is needed as it
was, so a copy of those rows is taken first. The number of blocks is fixed, which makes every
sum independent of the number of threads.
"""

import numba
import numpy as np
import torch
from torch import Tensor

from nolens.kernels.prefetch_numba import prefetch_row
from nolens.kernels.rows_numba import (
    FASTMATH,
    row_difference,
    row_gradient,
    row_outside,
    row_scene,
    row_sensor,
)
from nolens.kernels.threads import BLOCKS, block_rows, for_each_block

_SUMS = 15
_SEGMENT = 256
"""Cells of a row between two prefetches: longer ones wait for memory, shorter ones for the sums."""

Triple = tuple[float, float, float]


def update_splits_(
    pair: Tensor,
    measurement: tuple[Tensor, Tensor],
    arrays: tuple[Tensor, Tensor, Tensor, Tensor],
    windows: tuple[tuple[int, int, int, int], tuple[int, int, int, int]],
    prior: tuple[float, bool, float],
    step: tuple[Triple, Triple, float],
    *,
    counted: bool,
) -> tuple[Tensor, list[float] | None]:
    """See `nolens.kernels.admm.update_splits_`."""
    tv, isotropic, l1 = prior
    penalties, following, relaxation = step
    # With no penalty on a split its multiplier is absent, and 0/0 would be the rescaling.
    rescale = [
        now / later if later > 0 else 1.0 for now, later in zip(penalties, following, strict=True)
    ]
    constants = np.array([*penalties, *following, *rescale, relaxation, tv, l1], dtype=np.float32)
    height, width = pair.shape
    blocks = min(BLOCKS, height)
    sums = np.zeros((blocks, _SUMS))
    z = torch.view_as_real(pair).flatten(1).numpy()
    data = tuple(each.numpy() for each in measurement)
    states = tuple(each.numpy() for each in arrays)
    places = np.array(windows, dtype=np.int64)
    kind = (tv > 0, isotropic)
    starts = [block_rows(block, blocks, height)[0] for block in range(blocks)]
    heads = z[starts, ::2]
    last = np.empty((blocks, width), np.float32)

    def sweep(block: int) -> None:
        rows = block_rows(block, blocks, height)
        following = heads[(block + 1) % blocks]
        last[block] = _sweep_block(
            z,
            following,
            data,
            states,
            places,
            constants,
            kind,
            rows,
            sums[block] if counted else None,
        )

    for_each_block(sweep, blocks, pair.numel())
    if tv > 0:
        # The first row of every block still lacks what flows in from the block above it.
        z[starts, 1::2] += np.roll(last, 1, axis=0)
    return pair, [float(value) for value in sums.sum(axis=0)] if counted else None


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _add(sums, which, values):  # type: ignore[no-untyped-def]
    if sums is not None:
        for k in range(4):
            sums[3 * k + which] += values[k]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _add_one(sums, where, value):  # type: ignore[no-untyped-def]
    if sums is not None:
        sums[where] += value


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _add_variation(sums, values):  # type: ignore[no-untyped-def]
    _add(sums, 1, values)
    _add_one(sums, 13, values[4])


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _split_row(row, ahead, v, image):  # type: ignore[no-untyped-def]
    """Real and imaginary part of a row; v goes on periodically by one cell."""
    width = image.size
    for start in range(0, width, _SEGMENT):
        stop = min(start + _SEGMENT, width)
        prefetch_row(ahead[2 * start : 2 * stop])
        _split_segment(row[2 * start : 2 * stop], v[start:stop], image[start:stop])
    v[width] = v[0]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _split_segment(row, v, image):  # type: ignore[no-untyped-def]
    for j in range(image.size):
        v[j] = row[2 * j]
        image[j] = row[2 * j + 1]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _divergence_row(r, above, qy, qx):  # type: ignore[no-untyped-def]
    """Add Ψᵀq: what flows in from the left and from above, less what leaves."""
    width = qx.size
    r[0] += qx[width - 1] - qx[0] + above[0] - qy[0]
    for j in range(1, width):
        r[j] += qx[j - 1] - qx[j] + above[j] - qy[j]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _sweep_measured(image, a, ahead, b, valid, q, k, span, sums):  # type: ignore[no-untyped-def]
    """Split x = Mv of a row; `span` is where the sensor begins and ends in it."""
    begin, end = span
    for side in range(2):
        low, high = (0, begin) if side == 0 else (end, a.size)
        for start in range(low, high, _SEGMENT):
            stop = min(start + _SEGMENT, high)
            prefetch_row(ahead[start:stop])
            _add(sums, 0, row_outside(image[start:stop], a[start:stop], q[start:stop], k[9], sums))
    for start in range(begin, end, _SEGMENT):
        stop = min(start + _SEGMENT, end)
        prefetch_row(ahead[start:stop])
        values = row_sensor(
            image[start:stop],
            a[start:stop],
            b[start - begin : stop - begin],
            valid[start - begin : stop - begin],
            q[start:stop],
            k,
            sums,
        )
        _add(sums, 0, values)
        _add_one(sums, 12, values[4])


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _sweep_scene(v, a, ahead, r, k, span, sums):  # type: ignore[no-untyped-def]
    """Split w = v of a row; `span` is where the region begins and ends in it."""
    width = r.size
    start, stop = span
    for part in range(3):
        low = (0, start, stop)[part]
        high = (start, stop, width)[part]
        for begin in range(low, high, _SEGMENT):
            end = min(begin + _SEGMENT, high)
            prefetch_row(ahead[begin:end])
            values = row_scene(v[begin:end], a[begin:end], r[begin:end], k, part == 1, sums)
            _add(sums, 2, values)
            _add_one(sums, 14, values[4])


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _sweep_difference(v, neighbour, a, ahead, q, k, sums):  # type: ignore[no-untyped-def]
    """One direction of the split u = Ψv of a row."""
    for start in range(0, a.size, _SEGMENT):
        stop = min(start + _SEGMENT, a.size)
        prefetch_row(ahead[start:stop])
        part = slice(start, stop)
        values = row_difference(v[part], neighbour[part], a[part], q[part], k, sums)
        _add_variation(sums, values)


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _sweep_gradient(v, below, ay, ax, ahead_y, ahead_x, qy, qx, k, sums):  # type: ignore[no-untyped-def]
    """Both directions of the split u = Ψv of a row."""
    for start in range(0, ay.size, _SEGMENT):
        stop = min(start + _SEGMENT, ay.size)
        prefetch_row(ahead_y[start:stop])
        prefetch_row(ahead_x[start:stop])
        part = slice(start, stop)
        values = row_gradient(
            v[start : stop + 1], below[part], ay[part], ax[part], qy[part], qx[part], k, sums
        )
        _add_variation(sums, values)


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _span(i, window):  # type: ignore[no-untyped-def]
    """Columns of a window in row i; none in rows beside it."""
    top, left, rows, columns = window
    if top <= i < top + rows:
        return left, left + columns
    return 0, 0


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy")
def _sweep_block(z, following, measurement, arrays, windows, k, kind, rows, sums):  # type: ignore[no-untyped-def]
    """Rows first … stop − 1; `following` is v of row `stop`. Returns q_y of the last row."""
    b, valid = measurement
    a_x, a_y, a_h, a_w = arrays
    tv, isotropic = kind
    first, stop = rows
    width = z.shape[1] // 2
    v = np.empty(width + 1, np.float32)
    below = np.empty(width + 1, np.float32)
    image = np.empty(width, np.float32)
    image_below = np.empty(width, np.float32)
    q = np.empty(width, np.float32)
    r = np.empty(width, np.float32)
    above = np.zeros(width, np.float32)
    qy = np.zeros(width, np.float32)
    qx = np.zeros(width, np.float32)
    _split_row(z[first], z[min(first + 1, stop - 1)], below, image_below)
    for i in range(first, stop):
        v, below = below, v
        image, image_below = image_below, image
        if i + 1 < stop:
            _split_row(z[i + 1], z[min(i + 2, stop - 1)], below, image_below)
        else:
            below[:width] = following
        ahead = min(i + 1, stop - 1)
        line = max(0, min(i - windows[0, 0], b.shape[0] - 1))
        on_sensor = _span(i, windows[0])
        _sweep_measured(image, a_x[i], a_x[ahead], b[line], valid[line], q, k, on_sensor, sums)
        _sweep_scene(v, a_w[i], a_w[ahead], r, k, _span(i, windows[1]), sums)
        if tv:
            if isotropic:
                _sweep_gradient(v, below, a_y[i], a_h[i], a_y[ahead], a_h[ahead], qy, qx, k, sums)
            else:
                _sweep_difference(v, below, a_y[i], a_y[ahead], qy, k, sums)
                _sweep_difference(v, v[1:], a_h[i], a_h[ahead], qx, k, sums)
            _divergence_row(r, above, qy, qx)
            above, qy = qy, above
        row = z[i]
        for j in range(width):
            row[2 * j] = q[j]
            row[2 * j + 1] = r[j]
    return above
