"""CPU passes of ADMM, compiled by numba: one sweep over memory each.

**Update.** It sweeps blocks of rows. Within a block a row's pair (v, Mv) is read, its splits are
updated and the pair is overwritten; only the first row of the following block is needed as it
was, so a copy of those rows is taken first. The number of blocks is fixed, which makes every
sum independent of the number of threads.

The functions `_row_…` update the state of one split along a row, hand q = 2x − a on in a buffer,
and return its sums over the row: primal, split, change, multiplier change (see
`nolens.kernels.admm.PassSums`), and a fifth where there is one; they are zero, and the compiler
leaves them out, where `counted` is None. Rows are contiguous float32, so that the compiler
vectorises them. They are inlined by force: a function that is called may be the copy compiled for
itself or the one compiled with its caller, depending on what the cache had, and sums of the two
differ in their last bit. A row's sum in float32 is exact enough, sums over rows are kept in float64
by the caller. The constants k are those of `nolens.kernels.admm.step_constants`.

**Solve.** It takes two rows of the spectrum at a time. The spectrum of two real fields A + iB
holds, at k and −k, A + iB and conj(A) + i conj(B). Both are unpacked, solved for and packed again
in one go. Half a row and the mirrored half of its opposite row are first copied as real and
imaginary parts into buffers, which the compiler can vectorise.

**Prefetching.** The update works on one row of several arrays at a time. The processor's own
prefetching restarts at every row, and the pass would wait for each; asked for one row ahead, the
rows come while the one before is worked on. Some hundred pixels are asked for at a time, between
the loops over as many: a core follows some dozen lines at once, and a whole row asked for in one go
is waited for. The update at the paper's size takes 27 ms so (30 with its sums), 29 (38) without and
34 (39) with whole rows.
"""

from typing import Any

import numba
import numpy as np
import torch
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from torch import Tensor

from nolens.kernels.admm import SplitState
from nolens.kernels.threads import block_rows, blocks_of, for_each_block

_SUMS = 15
_SEGMENT = 256
"""Pixels of a row between prefetches: longer ones wait for memory, shorter ones for the sums."""
_FLOATS_PER_LINE = 16
_FOR_WRITING, _KEEP_IN_SECOND_LEVEL, _DATA = 1, 2, 1

_compiled = numba.njit(
    cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy"
)
# Python never calls these: what it would call them by takes seconds to compile.
_inlined = numba.njit(  # type: ignore[call-overload]
    fastmath={"reassoc", "contract", "nsz"},
    error_model="numpy",
    forceinline=True,
    no_cpython_wrapper=True,
    no_cfunc_wrapper=True,
)


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, constants: Tensor) -> Tensor:
    """See `nolens.kernels.admm_torch.solve_normal_equation_`."""
    height, width = spectrum.shape
    laplacians = _laplacian(height), _laplacian(width)[: width // 2 + 1]
    arrays = _floats(spectrum), _floats(transfer), *laplacians
    mu = constants[:3].numpy()
    blocks = blocks_of(height, spectrum.numel())

    def solve(block: int) -> None:
        _solve_rows(*arrays, mu, *block_rows(block, blocks, height))

    for_each_block(solve, blocks, spectrum.numel())
    return spectrum


def update_splits_(
    pair: Tensor, state: SplitState, constants: Tensor, *, counted: bool, out: Tensor
) -> list[float] | None:
    """See `nolens.kernels.admm_torch.update_splits_`."""
    height, width = pair.shape
    blocks = blocks_of(height, pair.numel())
    sums = np.zeros((blocks, _SUMS))
    z = _floats(pair)
    data = state.data.numpy(), state.valid.numpy()
    arrays = tuple(
        each.numpy() for each in (state.measured, state.rows, state.columns, state.scene)
    )
    windows = np.array((state.sensor, state.support), dtype=np.int64)
    kind = (state.tv > 0, state.isotropic)
    k = constants.numpy()
    starts = [block_rows(block, blocks, height)[0] for block in range(blocks)]
    heads = z[starts, ::2]
    last = np.empty((blocks, width), np.float32)

    def sweep(block: int) -> None:
        rows = block_rows(block, blocks, height)
        following = heads[(block + 1) % blocks]
        last[block] = _sweep_block(
            z, following, data, arrays, windows, k, kind, rows, sums[block] if counted else None
        )

    for_each_block(sweep, blocks, pair.numel())
    if state.tv > 0:
        # The first row of every block still lacks what flows in from the block above it.
        z[starts, 1::2] += np.roll(last, 1, axis=0)
    if out is not pair:
        out.copy_(pair)
    return [float(value) for value in sums.sum(axis=0)] if counted else None


def _floats(field: Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Rows of a complex field as real, imaginary, real, …: the same memory."""
    return torch.view_as_real(field).flatten(1).numpy()


def _laplacian(length: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Spectrum of one direction's ΨᵀΨ: 4 sin²(πk/length)."""
    return (4 * np.sin(np.pi * np.arange(length) / length) ** 2).astype(np.float32)


@intrinsic
def _prefetch(typing_context: Any, row: Any, index: Any) -> Any:
    """Prefetch the cache line of row[index]: LLVM's `llvm.prefetch`."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        array = context.make_array(signature.args[0])(context, builder, arguments[0])
        byte, number = ir.IntType(8).as_pointer(), ir.IntType(32)
        address = builder.bitcast(builder.gep(array.data, [arguments[1]]), byte)
        kind = ir.FunctionType(ir.VoidType(), [byte, number, number, number])
        function = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
            builder.module, kind, "llvm.prefetch.p0"
        )
        hints = [number(each) for each in (_FOR_WRITING, _KEEP_IN_SECOND_LEVEL, _DATA)]
        builder.call(function, [address, *hints])
        return context.get_dummy_value()

    return types.void(row, index), generate


@_inlined
def _prefetch_row(row):  # type: ignore[no-untyped-def]
    """Prefetch a contiguous row of float32."""
    for j in range(0, row.size, _FLOATS_PER_LINE):
        _prefetch(row, j)  # type: ignore[call-arg]


@_inlined
def _row_outside(image, a, q, alpha, counted):  # type: ignore[no-untyped-def]
    """Pixels beside the sensor: nothing was measured there, so x = a and q = a."""
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    for j in range(a.size):
        mv = image[j]
        old = a[j]
        step = alpha * (mv - old)
        new = old + step
        a[j] = new
        q[j] = new
        if counted is not None:
            primal += (mv - new) * (mv - new)
            split += new * new
            change += step * step
    none = np.float32(0)
    return primal, split, change, none


@_inlined
def _row_sensor(image, a, b, valid, q, k, counted):  # type: ignore[no-untyped-def]
    """Pixels on the sensor: x = (b + μa)/(1 + μ) where the pixel is valid, else x = a."""
    mu, rescale, alpha = k[0], k[6], k[9]
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    turned = np.float32(0)
    residual = np.float32(0)
    among_valid = np.float32(1) / (np.float32(1) + mu)
    among_others = np.float32(1) / mu
    for j in range(a.size):
        c = np.float32(valid[j])
        cb = c * b[j]
        weight = among_valid if valid[j] else among_others
        mv = image[j]
        old = a[j]
        x_old = (cb + mu * old) * weight
        new = old + alpha * (mv - x_old)
        x = (cb + mu * new) * weight
        d = new - x
        # The multiplier μd is kept while the penalty changes.
        stored = x + rescale * d
        a[j] = stored
        q[j] = np.float32(2) * x - stored
        if counted is not None:
            d_change = d - (old - x_old)
            miss = c * mv - cb
            primal += (mv - x) * (mv - x)
            split += x * x
            change += (x - x_old) * (x - x_old)
            turned += d_change * d_change
            residual += miss * miss
    return primal, split, change, turned, residual


@_inlined
def _row_scene(v, a, r, k, inside, counted):  # type: ignore[no-untyped-def]
    """Split w = v: x = max(a - λ/μ, 0) inside the support, 0 outside."""
    mu, later, rescale, alpha, l1 = k[2], k[5], k[8], k[9], k[11]
    shift = l1 / mu
    keep = np.float32(1) if inside else np.float32(0)
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    turned = np.float32(0)
    magnitude = np.float32(0)
    zero = np.float32(0)
    for j in range(a.size):
        here = v[j]
        old = a[j]
        x_old = keep * max(old - shift, zero)
        new = old + alpha * (here - x_old)
        x = keep * max(new - shift, zero)
        d = new - x
        stored = x + rescale * d
        a[j] = stored
        r[j] = later * (np.float32(2) * x - stored)
        if counted is not None:
            d_change = d - (old - x_old)
            primal += (here - x) * (here - x)
            split += x * x
            change += (x - x_old) * (x - x_old)
            turned += d_change * d_change
            magnitude += abs(here)
    return primal, split, change, turned, magnitude


@_inlined
def _shrink(a, threshold):  # type: ignore[no-untyped-def]
    zero = np.float32(0)
    return max(a - threshold, zero) - max(-a - threshold, zero)


@_inlined
def _shrink_pair(a, b, threshold):  # type: ignore[no-untyped-def]
    size = np.sqrt(a * a + b * b)
    scale = max(size - threshold, np.float32(0)) / max(size, np.float32(1e-30))
    return scale * a, scale * b


@_inlined
def _row_difference(v, neighbour, a, q, k, counted):  # type: ignore[no-untyped-def]
    """One direction of the split u = Ψv: each difference shrinks by τ/μ.

    The two directions are two loops, as the compiler gives up on vectorising one that works
    on all six arrays.
    """
    mu, later, rescale, alpha, tv = k[1], k[4], k[7], k[9], k[10]
    threshold = tv / mu
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    turned = np.float32(0)
    variation = np.float32(0)
    for j in range(a.size):
        g = neighbour[j] - v[j]
        old = a[j]
        u_old = _shrink(old, threshold)
        new = old + alpha * (g - u_old)
        u = _shrink(new, threshold)
        d = new - u
        stored = u + rescale * d
        a[j] = stored
        q[j] = later * (np.float32(2) * u - stored)
        if counted is not None:
            d_change = d - (old - u_old)
            primal += (g - u) * (g - u)
            split += u * u
            change += (u - u_old) * (u - u_old)
            turned += d_change * d_change
            variation += abs(g)
    return primal, split, change, turned, variation


@_inlined
def _row_gradient(v, below, ay, ax, qy, qx, k, counted):  # type: ignore[no-untyped-def]
    """Both directions of the split u = Ψv: the pair shrinks by τ/μ in its Euclidean length."""
    mu, later, rescale, alpha, tv = k[1], k[4], k[7], k[9], k[10]
    threshold = tv / mu
    two = np.float32(2)
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    turned = np.float32(0)
    variation = np.float32(0)
    for j in range(ay.size):
        gy = below[j] - v[j]
        gx = v[j + 1] - v[j]
        old_y = ay[j]
        old_x = ax[j]
        uy_old, ux_old = _shrink_pair(old_y, old_x, threshold)
        new_y = old_y + alpha * (gy - uy_old)
        new_x = old_x + alpha * (gx - ux_old)
        uy, ux = _shrink_pair(new_y, new_x, threshold)
        dy = new_y - uy
        dx = new_x - ux
        stored_y = uy + rescale * dy
        stored_x = ux + rescale * dx
        ay[j] = stored_y
        ax[j] = stored_x
        qy[j] = later * (two * uy - stored_y)
        qx[j] = later * (two * ux - stored_x)
        if counted is not None:
            dy_change = dy - (old_y - uy_old)
            dx_change = dx - (old_x - ux_old)
            primal += (gy - uy) * (gy - uy) + (gx - ux) * (gx - ux)
            split += uy * uy + ux * ux
            change += (uy - uy_old) * (uy - uy_old) + (ux - ux_old) * (ux - ux_old)
            turned += dy_change * dy_change + dx_change * dx_change
            variation += np.sqrt(gy * gy + gx * gx)
    return primal, split, change, turned, variation


@_inlined
def _add(sums, which, values):  # type: ignore[no-untyped-def]
    if sums is not None:
        for k in range(4):
            sums[3 * k + which] += values[k]


@_inlined
def _add_one(sums, where, value):  # type: ignore[no-untyped-def]
    if sums is not None:
        sums[where] += value


@_inlined
def _add_variation(sums, values):  # type: ignore[no-untyped-def]
    _add(sums, 1, values)
    _add_one(sums, 13, values[4])


@_inlined
def _split_row(row, ahead, v, image):  # type: ignore[no-untyped-def]
    """Real and imaginary part of a row; v goes on periodically by one pixel."""
    width = image.size
    for start in range(0, width, _SEGMENT):
        stop = min(start + _SEGMENT, width)
        _prefetch_row(ahead[2 * start : 2 * stop])
        _split_segment(row[2 * start : 2 * stop], v[start:stop], image[start:stop])
    v[width] = v[0]


@_inlined
def _split_segment(row, v, image):  # type: ignore[no-untyped-def]
    for j in range(image.size):
        v[j] = row[2 * j]
        image[j] = row[2 * j + 1]


@_inlined
def _divergence_row(r, above, qy, qx):  # type: ignore[no-untyped-def]
    """Add Ψᵀq: what flows in from the left and from above, less what leaves."""
    width = qx.size
    r[0] += qx[width - 1] - qx[0] + above[0] - qy[0]
    for j in range(1, width):
        r[j] += qx[j - 1] - qx[j] + above[j] - qy[j]


@_inlined
def _sweep_measured(image, a, ahead, b, valid, q, k, span, sums):  # type: ignore[no-untyped-def]
    """Split x = Mv of a row; `span` is where the sensor begins and ends in it."""
    begin, end = span
    for side in range(2):
        low, high = (0, begin) if side == 0 else (end, a.size)
        for start in range(low, high, _SEGMENT):
            stop = min(start + _SEGMENT, high)
            _prefetch_row(ahead[start:stop])
            _add(sums, 0, _row_outside(image[start:stop], a[start:stop], q[start:stop], k[9], sums))
    for start in range(begin, end, _SEGMENT):
        stop = min(start + _SEGMENT, end)
        _prefetch_row(ahead[start:stop])
        values = _row_sensor(
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


@_inlined
def _sweep_scene(v, a, ahead, r, k, span, sums):  # type: ignore[no-untyped-def]
    """Split w = v of a row; `span` is where the support begins and ends in it."""
    width = r.size
    start, stop = span
    for part in range(3):
        low = (0, start, stop)[part]
        high = (start, stop, width)[part]
        for begin in range(low, high, _SEGMENT):
            end = min(begin + _SEGMENT, high)
            _prefetch_row(ahead[begin:end])
            values = _row_scene(v[begin:end], a[begin:end], r[begin:end], k, part == 1, sums)
            _add(sums, 2, values)
            _add_one(sums, 14, values[4])


@_inlined
def _sweep_difference(v, neighbour, a, ahead, q, k, sums):  # type: ignore[no-untyped-def]
    """One direction of the split u = Ψv of a row."""
    for start in range(0, a.size, _SEGMENT):
        stop = min(start + _SEGMENT, a.size)
        _prefetch_row(ahead[start:stop])
        part = slice(start, stop)
        values = _row_difference(v[part], neighbour[part], a[part], q[part], k, sums)
        _add_variation(sums, values)


@_inlined
def _sweep_gradient(v, below, ay, ax, ahead_y, ahead_x, qy, qx, k, sums):  # type: ignore[no-untyped-def]
    """Both directions of the split u = Ψv of a row."""
    for start in range(0, ay.size, _SEGMENT):
        stop = min(start + _SEGMENT, ay.size)
        _prefetch_row(ahead_y[start:stop])
        _prefetch_row(ahead_x[start:stop])
        part = slice(start, stop)
        values = _row_gradient(
            v[start : stop + 1], below[part], ay[part], ax[part], qy[part], qx[part], k, sums
        )
        _add_variation(sums, values)


@_inlined
def _span(i, window):  # type: ignore[no-untyped-def]
    """Columns of a window in row i; none in rows beside it."""
    top, left, rows, columns = window
    if top <= i < top + rows:
        return left, left + columns
    return 0, 0


@_compiled
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
            for j in range(width):  # A slice takes seconds to compile.
                below[j] = following[j]
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


@_compiled
def _solve_rows(z, transfer, lap_rows, lap_columns, mu, first, stop):  # type: ignore[no-untyped-def]
    height, width = z.shape[0], z.shape[1] // 2
    half = (width + 1) // 2
    # Columns 1 … half − 1 of a row, against columns width − 1 … width − half + 1 of its opposite.
    near, far = slice(2, 2 * half), slice(2 * (width - half + 1), 2 * width)
    buffers = np.empty((8, half - 1), np.float32)
    for i in range(first, stop):
        mirror = (height - i) % height
        here, there, h = z[i], z[mirror], transfer[i]
        rest = np.float32(mu[1] * lap_rows[i] + mu[2])
        _solve_half(here[near], there[far], h[near], lap_columns[1:half], mu, rest, buffers)
        # Columns 0 and width/2 hold both ends of a pair: the first row of the two acts.
        if i <= mirror:
            _solve_pair(here[:2], there[:2], h[:2], mu, rest)
            if width % 2 == 0:
                middle = slice(2 * half, 2 * half + 2)
                here, there, h = here[middle], there[middle], h[middle]
                _solve_pair(here, there, h, mu, rest + mu[1] * lap_columns[half])


@_inlined
def _solve_half(here, there, transfer, laplacian, mu, rest, buffers):  # type: ignore[no-untyped-def]
    here_re, here_im, there_re, there_im = buffers[0], buffers[1], buffers[2], buffers[3]
    h_re, h_im, far_re, far_im = buffers[4], buffers[5], buffers[6], buffers[7]
    _apart(here, here_re, here_im)
    _apart(transfer, h_re, h_im)
    _apart(there, far_re, far_im)
    _turn(far_re, there_re)
    _turn(far_im, there_im)
    mu_x, mu_u = mu[0], mu[1]
    for j in range(here_re.size):
        first_re, first_im, second_re, second_im = _solved(
            here_re[j],
            here_im[j],
            there_re[j],
            there_im[j],
            h_re[j],
            h_im[j],
            mu_x,
            rest + mu_u * laplacian[j],
        )
        here_re[j] = first_re
        here_im[j] = first_im
        there_re[j] = second_re
        there_im[j] = second_im
    _turn(there_re, far_re)
    _turn(there_im, far_im)
    _together(here, here_re, here_im)
    _together(there, far_re, far_im)


@_inlined
def _solve_pair(here, there, transfer, mu, rest):  # type: ignore[no-untyped-def]
    """The same for one pair; `here` and `there` may be the same pixel."""
    first_re, first_im, second_re, second_im = _solved(
        here[0], here[1], there[0], there[1], transfer[0], transfer[1], mu[0], rest
    )
    here[0] = first_re
    here[1] = first_im
    there[0] = second_re
    there[1] = second_im


@_inlined
def _solved(x_re, x_im, y_re, y_im, h_re, h_im, mu_x, rest):  # type: ignore[no-untyped-def]
    """(v + i Mv) at k and at −k, from (q + i r) at k and at −k."""
    half = np.float32(0.5)
    a_re = half * (x_re + y_re)
    a_im = half * (x_im - y_im)
    b_re = half * (x_im + y_im)
    b_im = half * (y_re - x_re)
    scale = np.float32(1) / (mu_x * (h_re * h_re + h_im * h_im) + rest)
    v_re = (mu_x * (h_re * a_re + h_im * a_im) + b_re) * scale
    v_im = (mu_x * (h_re * a_im - h_im * a_re) + b_im) * scale
    m_re = h_re * v_re - h_im * v_im
    m_im = h_re * v_im + h_im * v_re
    return v_re - m_im, v_im + m_re, v_re + m_im, m_re - v_im


@_inlined
def _apart(row, real, imaginary):  # type: ignore[no-untyped-def]
    for j in range(real.size):
        real[j] = row[2 * j]
        imaginary[j] = row[2 * j + 1]


@_inlined
def _together(row, real, imaginary):  # type: ignore[no-untyped-def]
    for j in range(real.size):
        row[2 * j] = real[j]
        row[2 * j + 1] = imaginary[j]


@_inlined
def _turn(row, turned):  # type: ignore[no-untyped-def]
    """Last pixel first; unsigned, or the compiler minds indices below zero."""
    count = np.uintp(turned.size)
    for j in range(count):
        turned[j] = row[count - np.uintp(1) - j]
