"""CPU passes of ADMM: one sweep over memory each, compiled by numba.

The update sweeps blocks of rows. Within a block a row's pair (v, Mv) is read, its splits are
updated and the pair is overwritten; only the first row of the following block is needed as it
was, so a copy of those rows is taken first. The number of blocks is fixed, which makes every
sum independent of the number of threads.
"""

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from nolens.kernels.rows_numba import (
    FASTMATH,
    row_difference,
    row_gradient,
    row_outside,
    row_scene,
    row_sensor,
)
from nolens.kernels.threads import for_each_block

_BLOCKS = 32
_SUMS = 21

Triple = tuple[float, float, float]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
    """See `nolens.kernels.admm.solve_normal_equation_`."""
    height, width = spectrum.shape
    laplacians = _laplacian(height), _laplacian(width)[: width // 2 + 1]
    reals = torch.view_as_real(spectrum).numpy(), torch.view_as_real(transfer).numpy()
    arrays = (*reals, *laplacians)
    mu = np.array(penalties, dtype=np.float32)
    blocks = min(_BLOCKS, height)

    def solve(block: int) -> None:
        _solve_rows(*arrays, mu, *_rows(block, blocks, height))

    for_each_block(solve, blocks, spectrum.numel())
    return spectrum


def update_splits_(
    pair: Tensor,
    measurement: tuple[Tensor, Tensor],
    arrays: tuple[Tensor, Tensor, Tensor, Tensor],
    windows: tuple[tuple[int, int, int, int], tuple[int, int, int, int]],
    prior: tuple[float, bool, float],
    step: tuple[Triple, Triple, float],
) -> tuple[Tensor, list[float]]:
    """See `nolens.kernels.admm.update_splits_`."""
    tv, isotropic, l1 = prior
    penalties, following, relaxation = step
    # With no penalty on a split its multiplier is absent, and 0/0 would be the rescaling.
    rescale = [
        now / later if later > 0 else 1.0 for now, later in zip(penalties, following, strict=True)
    ]
    constants = np.array([*penalties, *following, *rescale, relaxation, tv, l1], dtype=np.float32)
    height, width = pair.shape
    blocks = min(_BLOCKS, height)
    sums = np.zeros((blocks, _SUMS))
    z = torch.view_as_real(pair).flatten(1).numpy()
    data = tuple(each.numpy() for each in measurement)
    states = tuple(each.numpy() for each in arrays)
    places = np.array(windows, dtype=np.int64)
    kind = (tv > 0, isotropic)
    starts = [_rows(block, blocks, height)[0] for block in range(blocks)]
    heads = z[starts, ::2]
    last = np.empty((blocks, width), np.float32)

    def sweep(block: int) -> None:
        rows = _rows(block, blocks, height)
        following = heads[(block + 1) % blocks]
        last[block] = _sweep_block(
            z, following, data, states, places, constants, kind, rows, sums[block]
        )

    for_each_block(sweep, blocks, pair.numel())
    if tv > 0:
        # The first row of every block still lacks what flows in from the block above it.
        z[starts, 1::2] += np.roll(last, 1, axis=0)
    return pair, [float(value) for value in sums.sum(axis=0)]


def _rows(block: int, blocks: int, height: int) -> tuple[int, int]:
    """First and last + 1 of a block's rows."""
    return block * height // blocks, (block + 1) * height // blocks


def _laplacian(length: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Spectrum of one direction's ΨᵀΨ: 4 sin²(πk/length)."""
    return (4 * np.sin(np.pi * np.arange(length) / length) ** 2).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH)
def _solve_rows(z, transfer, lap_rows, lap_columns, mu, first, stop):  # type: ignore[no-untyped-def]
    height, width, _ = z.shape
    for i in range(first, stop):
        mirror = (height - i) % height
        here, there = z[i], z[mirror]
        half = (width + 1) // 2
        mu_row = np.float32(mu[1] * lap_rows[i] + mu[2])
        for j in range(1, half):
            _solve_pair(here, j, there, width - j, transfer[i], mu, mu_row + mu[1] * lap_columns[j])
        # Columns 0 and width/2 hold both ends of a pair: the first row of the two acts.
        if i <= mirror:
            _solve_pair(here, 0, there, 0, transfer[i], mu, mu_row)
            if width % 2 == 0:
                _solve_pair(
                    here, half, there, half, transfer[i], mu, mu_row + mu[1] * lap_columns[half]
                )


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, inline="always")
def _solve_pair(here, j, there, opposite, transfer, mu, rest):  # type: ignore[no-untyped-def]
    """Unpack two real fields at k and -k, solve, and pack v + i Mv."""
    half = np.float32(0.5)
    h_re, h_im = transfer[j, 0], transfer[j, 1]
    # here and there are A + iB and conj(A) + i conj(B).
    a_re = half * (here[j, 0] + there[opposite, 0])
    a_im = half * (here[j, 1] - there[opposite, 1])
    b_re = half * (here[j, 1] + there[opposite, 1])
    b_im = half * (there[opposite, 0] - here[j, 0])
    scale = np.float32(1) / (mu[0] * (h_re * h_re + h_im * h_im) + rest)
    v_re = (mu[0] * (h_re * a_re + h_im * a_im) + b_re) * scale
    v_im = (mu[0] * (h_re * a_im - h_im * a_re) + b_im) * scale
    m_re = h_re * v_re - h_im * v_im
    m_im = h_re * v_im + h_im * v_re
    here[j, 0] = v_re - m_im
    here[j, 1] = v_im + m_re
    there[opposite, 0] = v_re + m_im
    there[opposite, 1] = m_re - v_im


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _add(sums, which, values):  # type: ignore[no-untyped-def]
    for k in range(6):
        sums[3 * k + which] += values[k]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _add_variation(sums, values):  # type: ignore[no-untyped-def]
    _add(sums, 1, values)
    sums[19] += values[6]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _split_row(row, v, image):  # type: ignore[no-untyped-def]
    """Real and imaginary part of a row; v goes on periodically by one cell."""
    width = image.size
    for j in range(width):
        v[j] = row[2 * j]
        image[j] = row[2 * j + 1]
    v[width] = v[0]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _divergence_row(r, above, qy, qx):  # type: ignore[no-untyped-def]
    """Add Ψᵀq: what flows in from the left and from above, less what leaves."""
    width = qx.size
    r[0] += qx[width - 1] - qx[0] + above[0] - qy[0]
    for j in range(1, width):
        r[j] += qx[j - 1] - qx[j] + above[j] - qy[j]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _sweep_measured(image, a, b, valid, q, k, span, sums):  # type: ignore[no-untyped-def]
    """Split x = Mv of a row; `span` is where the sensor begins and ends in it."""
    width = image.size
    start, stop = span
    _add(sums, 0, row_outside(image, a, k[9], 0, start))
    q[:start] = a[:start]
    if stop > start:
        values = row_sensor(image, a, b, valid, q, k, start, stop)
        _add(sums, 0, values)
        sums[18] += values[6]
    _add(sums, 0, row_outside(image, a, k[9], stop, width))
    q[stop:] = a[stop:]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _sweep_scene(v, a, r, k, span, sums):  # type: ignore[no-untyped-def]
    """Split w = v of a row; `span` is where the region begins and ends in it."""
    width = r.size
    start, stop = span
    for part in range(3):
        begin = (0, start, stop)[part]
        end = (start, stop, width)[part]
        values = row_scene(v, a, r, k, begin, end, part == 1)
        _add(sums, 2, values)
        sums[20] += values[6]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, forceinline=True)
def _span(i, window):  # type: ignore[no-untyped-def]
    """Columns of a window in row i; none in rows beside it."""
    top, left, rows, columns = window
    if top <= i < top + rows:
        return left, left + columns
    return 0, 0


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH)
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
    _split_row(z[first], below, image_below)
    for i in range(first, stop):
        v, below = below, v
        image, image_below = image_below, image
        if i + 1 < stop:
            _split_row(z[i + 1], below, image_below)
        else:
            below[:width] = following
        line = max(0, min(i - windows[0, 0], b.shape[0] - 1))
        on_sensor = _span(i, windows[0])
        _sweep_measured(image, a_x[i], b[line], valid[line], q, k, on_sensor, sums)
        _sweep_scene(v, a_w[i], r, k, _span(i, windows[1]), sums)
        if tv:
            if isotropic:
                _add_variation(sums, row_gradient(v, below, a_y[i], a_h[i], qy, qx, k))
            else:
                _add_variation(sums, row_difference(v, below, a_y[i], qy, k))
                _add_variation(sums, row_difference(v, v[1:], a_h[i], qx, k))
            _divergence_row(r, above, qy, qx)
            above, qy = qy, above
        row = z[i]
        for j in range(width):
            row[2 * j] = q[j]
            row[2 * j + 1] = r[j]
    return above
