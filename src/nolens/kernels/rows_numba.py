"""What the passes of ADMM do to one row, compiled by numba.

Every function updates the state of one split along a row, hands q = 2x − a on in a buffer, and
returns its sums over the row: primal, split, change, multiplier change (see
`nolens.kernels.admm.PassSums`), and a fifth where there is one; they are zero, and the
compiler leaves them out, where `counted` is None. Rows are contiguous float32,
so that the compiler vectorises them. They are inlined by force: a function that is called may be
the copy compiled for itself or the one compiled with its caller, depending on what the cache had,
and sums of the two differ in their last bit. A row's sum in float32 is exact enough, sums over
rows are kept in float64 by the caller. The constants k are μ of (x, u, w), their following
values, their ratios, α, τ and λ.
"""

import numba
import numpy as np

FASTMATH = {"reassoc", "contract", "nsz"}


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def row_outside(image, a, q, alpha, counted):  # type: ignore[no-untyped-def]
    """Cells beside the sensor: nothing was measured there, so x = a and q = a."""
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def row_sensor(image, a, b, valid, q, k, counted):  # type: ignore[no-untyped-def]
    """Cells on the sensor: x = (b + μa)/(1 + μ) where the pixel is valid, else x = a."""
    mu, rescale, alpha = k[0], k[6], k[9]
    primal = np.float32(0)
    split = np.float32(0)
    change = np.float32(0)
    turned = np.float32(0)
    misfit = np.float32(0)
    among_valid = np.float32(1) / (np.float32(1) + mu)
    among_others = np.float32(1) / mu
    for j in range(a.size):
        c = np.float32(valid[j])
        cb = c * b[j]
        share = among_valid if valid[j] else among_others
        mv = image[j]
        old = a[j]
        x_old = (cb + mu * old) * share
        new = old + alpha * (mv - x_old)
        x = (cb + mu * new) * share
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
            misfit += miss * miss
    return primal, split, change, turned, misfit


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def row_scene(v, a, r, k, inside, counted):  # type: ignore[no-untyped-def]
    """Split w = v: x = max(a - λ/μ, 0) inside the region, 0 outside."""
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _shrink(a, threshold):  # type: ignore[no-untyped-def]
    zero = np.float32(0)
    return max(a - threshold, zero) - max(-a - threshold, zero)


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _shrink_pair(a, b, threshold):  # type: ignore[no-untyped-def]
    size = np.sqrt(a * a + b * b)
    scale = max(size - threshold, np.float32(0)) / max(size, np.float32(1e-30))
    return scale * a, scale * b


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def row_difference(v, neighbour, a, q, k, counted):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def row_gradient(v, below, ay, ax, qy, qx, k, counted):  # type: ignore[no-untyped-def]
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
