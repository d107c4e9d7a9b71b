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

_BLOCKS = 32
_SUMS = 21
_FASTMATH = {"reassoc", "contract", "nsz"}

Triple = tuple[float, float, float]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
    """See `nolens.kernels.admm.solve_normal_equation_`."""
    height, width = spectrum.shape
    _use_torch_threads()
    _solve(
        spectrum.numpy(),
        transfer.numpy(),
        _laplacian(height),
        _laplacian(width)[: width // 2 + 1],
        *(np.float32(penalty) for penalty in penalties),
    )
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
    blocks = min(_BLOCKS, pair.shape[0])
    sums = np.zeros((blocks, _SUMS))
    _use_torch_threads()
    _update(
        pair.numpy(),
        measurement[0].numpy(),
        measurement[1].numpy(),
        arrays[0].numpy(),
        arrays[1].numpy(),
        arrays[2].numpy(),
        arrays[3].numpy(),
        np.array(windows, dtype=np.int64),
        constants,
        tv > 0,
        isotropic,
        sums,
    )
    return pair, [float(value) for value in sums.sum(axis=0)]


def _use_torch_threads() -> None:
    numba.set_num_threads(min(torch.get_num_threads(), numba.config.NUMBA_NUM_THREADS))  # type: ignore[attr-defined]


def _laplacian(length: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Spectrum of one direction's ΨᵀΨ: 4 sin²(πk/length)."""
    return (4 * np.sin(np.pi * np.arange(length) / length) ** 2).astype(np.float32)


@numba.njit(parallel=True, cache=True, nogil=True, fastmath=_FASTMATH)
def _solve(z, transfer, lap_rows, lap_columns, mu_x, mu_u, mu_w):  # type: ignore[no-untyped-def]
    height, width = z.shape
    half = np.float32(0.5)
    for i in numba.prange(height):
        mirror = (height - i) % height
        for j in range(width // 2 + 1):
            opposite = (width - j) % width
            # Columns 0 and width/2 hold both ends of a pair: the first row of the two acts.
            if opposite == j and mirror < i:
                continue
            h = transfer[i, j]
            here = z[i, j]
            there = z[mirror, opposite]
            # here and there are A + iB and conj(A) + i conj(B).
            a_re = half * (here.real + there.real)
            a_im = half * (here.imag - there.imag)
            b_re = half * (here.imag + there.imag)
            b_im = half * (there.real - here.real)
            power = h.real * h.real + h.imag * h.imag
            scale = np.float32(1) / (mu_x * power + mu_u * (lap_rows[i] + lap_columns[j]) + mu_w)
            v_re = (mu_x * (h.real * a_re + h.imag * a_im) + b_re) * scale
            v_im = (mu_x * (h.real * a_im - h.imag * a_re) + b_im) * scale
            m_re = h.real * v_re - h.imag * v_im
            m_im = h.real * v_im + h.imag * v_re
            z[i, j] = complex(v_re - m_im, v_im + m_re)
            z[mirror, opposite] = complex(v_re + m_im, m_re - v_im)


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _row_outside(z, a, alpha, start, stop):  # type: ignore[no-untyped-def]
    """Cells beside the sensor: nothing was measured there, so x = a and q = a."""
    primal = np.float32(0)
    field = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    for j in range(start, stop):
        mv = z[j].imag
        old = a[j]
        step = alpha * (mv - old)
        new = old + step
        a[j] = new
        primal += (mv - new) * (mv - new)
        field += mv * mv
        split += new * new
        change += step * step
    none = np.float32(0)
    return primal, field, split, change, none, none


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _row_sensor(z, a, b, valid, q, k, start, stop):  # type: ignore[no-untyped-def]
    """Cells on the sensor: x = (b + μa)/(1 + μ) where the pixel is valid, else x = a."""
    mu, rescale, alpha = k[0], k[6], k[9]
    primal = np.float32(0)
    field = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    multiplier = np.float32(0)
    turned = np.float32(0)
    misfit = np.float32(0)
    for j in range(start, stop):
        c = np.float32(valid[j - start])
        cb = c * b[j - start]
        mv = z[j].imag
        old = a[j]
        x_old = (cb + mu * old) / (c + mu)
        new = old + alpha * (mv - x_old)
        x = (cb + mu * new) / (c + mu)
        d = new - x
        d_change = d - (old - x_old)
        # The multiplier μd is kept while the penalty changes.
        stored = x + rescale * d
        a[j] = stored
        q[j] = np.float32(2) * x - stored
        miss = c * mv - cb
        primal += (mv - x) * (mv - x)
        field += mv * mv
        split += x * x
        change += (x - x_old) * (x - x_old)
        multiplier += d * d
        turned += d_change * d_change
        misfit += miss * miss
    return primal, field, split, change, multiplier, turned, misfit


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _row_scene(z, a, r, k, start, stop, inside):  # type: ignore[no-untyped-def]
    """Split w = v: x = max(a - λ/μ, 0) inside the region, 0 outside."""
    mu, later, rescale, alpha, l1 = k[2], k[5], k[8], k[9], k[11]
    shift = l1 / mu
    keep = np.float32(1) if inside else np.float32(0)
    primal = np.float32(0)
    field = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    multiplier = np.float32(0)
    turned = np.float32(0)
    magnitude = np.float32(0)
    zero = np.float32(0)
    for j in range(start, stop):
        v = z[j].real
        old = a[j]
        x_old = keep * max(old - shift, zero)
        new = old + alpha * (v - x_old)
        x = keep * max(new - shift, zero)
        d = new - x
        d_change = d - (old - x_old)
        stored = x + rescale * d
        a[j] = stored
        r[j] = later * (np.float32(2) * x - stored)
        primal += (v - x) * (v - x)
        field += v * v
        split += x * x
        change += (x - x_old) * (x - x_old)
        multiplier += d * d
        turned += d_change * d_change
        magnitude += abs(v)
    return primal, field, split, change, multiplier, turned, magnitude


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _shrink(a, threshold):  # type: ignore[no-untyped-def]
    zero = np.float32(0)
    return max(a - threshold, zero) - max(-a - threshold, zero)


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _shrink_pair(a, b, threshold):  # type: ignore[no-untyped-def]
    size = np.sqrt(a * a + b * b)
    scale = max(size - threshold, np.float32(0)) / max(size, np.float32(1e-30))
    return scale * a, scale * b


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _row_gradient(v, below, ay, ax, qy, qx, k, isotropic):  # type: ignore[no-untyped-def]
    """Split u = Ψv: shrinkage by τ/μ of each difference, or of their Euclidean length."""
    mu, later, rescale, alpha, tv = k[1], k[4], k[7], k[9], k[10]
    width = ay.size
    threshold = tv / mu
    two = np.float32(2)
    primal = np.float32(0)
    field = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    multiplier = np.float32(0)
    turned = np.float32(0)
    variation = np.float32(0)
    for j in range(width):
        following = j + 1 if j + 1 < width else 0
        here = v[j].real
        gy = below[j] - here
        gx = v[following].real - here
        old_y = ay[j]
        old_x = ax[j]
        if isotropic:
            uy_old, ux_old = _shrink_pair(old_y, old_x, threshold)
        else:
            uy_old, ux_old = _shrink(old_y, threshold), _shrink(old_x, threshold)
        new_y = old_y + alpha * (gy - uy_old)
        new_x = old_x + alpha * (gx - ux_old)
        if isotropic:
            uy, ux = _shrink_pair(new_y, new_x, threshold)
            variation += np.sqrt(gy * gy + gx * gx)
        else:
            uy, ux = _shrink(new_y, threshold), _shrink(new_x, threshold)
            variation += abs(gy) + abs(gx)
        dy = new_y - uy
        dx = new_x - ux
        dy_change = dy - (old_y - uy_old)
        dx_change = dx - (old_x - ux_old)
        stored_y = uy + rescale * dy
        stored_x = ux + rescale * dx
        ay[j] = stored_y
        ax[j] = stored_x
        qy[j] = later * (two * uy - stored_y)
        qx[j] = later * (two * ux - stored_x)
        primal += (gy - uy) * (gy - uy) + (gx - ux) * (gx - ux)
        field += gy * gy + gx * gx
        split += uy * uy + ux * ux
        change += (uy - uy_old) * (uy - uy_old) + (ux - ux_old) * (ux - ux_old)
        multiplier += dy * dy + dx * dx
        turned += dy_change * dy_change + dx_change * dx_change
    return primal, field, split, change, multiplier, turned, variation


@numba.njit(cache=True, nogil=True, fastmath=_FASTMATH)
def _add(sums, which, values):  # type: ignore[no-untyped-def]
    for k in range(6):
        sums[3 * k + which] += values[k]


@numba.njit(parallel=True, cache=True, nogil=True, fastmath=_FASTMATH)
def _update(z, b, valid, a_x, a_y, a_h, a_w, windows, k, tv, isotropic, sums):  # type: ignore[no-untyped-def]
    height, width = z.shape
    blocks = sums.shape[0]
    top, left, rows, columns = windows[0]
    r_top, r_left, r_rows, r_columns = windows[1]
    alpha = k[9]
    heads = np.empty((blocks, width), np.float32)
    last = np.empty((blocks, width), np.float32)
    for block in numba.prange(blocks):
        heads[block] = z[block * height // blocks].real
    for block in numba.prange(blocks):
        first = block * height // blocks
        stop = (block + 1) * height // blocks
        q = np.empty(width, np.float32)
        r = np.empty(width, np.float32)
        above = np.zeros(width, np.float32)
        qy = np.zeros(width, np.float32)
        qx = np.zeros(width, np.float32)
        below = np.empty(width, np.float32)
        mine = sums[block]
        for i in range(first, stop):
            row = z[i]
            if tv:
                if i + 1 < stop:
                    below[:] = z[i + 1].real
                else:
                    below[:] = heads[(block + 1) % blocks]
                values = _row_gradient(row, below, a_y[i], a_h[i], qy, qx, k, isotropic)
                _add(mine, 1, values)
                mine[19] += values[6]
            if top <= i < top + rows:
                right = left + columns
                for edge in range(2):
                    begin = 0 if edge == 0 else right
                    end = left if edge == 0 else width
                    beside = _row_outside(row, a_x[i], alpha, begin, end)
                    _add(mine, 0, beside)
                    q[begin:end] = a_x[i, begin:end]
                on = _row_sensor(row, a_x[i], b[i - top], valid[i - top], q, k, left, right)
                _add(mine, 0, on)
                mine[18] += on[6]
            else:
                beside = _row_outside(row, a_x[i], alpha, 0, width)
                _add(mine, 0, beside)
                q[:] = a_x[i]
            if r_top <= i < r_top + r_rows:
                right = r_left + r_columns
                dark = _row_scene(row, a_w[i], r, k, 0, r_left, False)
                _add(mine, 2, dark)
                mine[20] += dark[6]
                lit = _row_scene(row, a_w[i], r, k, r_left, right, True)
                _add(mine, 2, lit)
                mine[20] += lit[6]
                dark = _row_scene(row, a_w[i], r, k, right, width, False)
            else:
                dark = _row_scene(row, a_w[i], r, k, 0, width, False)
            _add(mine, 2, dark)
            mine[20] += dark[6]
            if tv:
                # Ψᵀ: what flows in from the left and from above, less what leaves.
                r[0] += qx[width - 1] - qx[0] + above[0] - qy[0]
                for j in range(1, width):
                    r[j] += qx[j - 1] - qx[j] + above[j] - qy[j]
                above[:] = qy
            for j in range(width):
                row[j] = complex(q[j], r[j])
        last[block] = above
    if tv:
        # The first row of every block still lacks what flows in from the block above it.
        for block in range(blocks):
            head = z[block * height // blocks]
            for j in range(width):
                head[j] = complex(head[j].real, head[j].imag + last[block - 1, j])
