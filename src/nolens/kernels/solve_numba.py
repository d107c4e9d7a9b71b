"""The solve of ADMM's normal equation on the CPU: two rows of the spectrum at a time.

The spectrum of two real fields A + iB holds, at k and −k, A + iB and conj(A) + i conj(B). Both are
unpacked, solved for and packed again in one go. Half a row and the mirrored half of its opposite
row are first laid out as real and imaginary parts in buffers, which the compiler can vectorise.
"""

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor

from nolens.kernels.rows_numba import FASTMATH
from nolens.kernels.threads import BLOCKS, block_rows, for_each_block

Triple = tuple[float, float, float]


def solve_normal_equation_(spectrum: Tensor, transfer: Tensor, penalties: Triple) -> Tensor:
    """See `nolens.kernels.admm.solve_normal_equation_`."""
    height, width = spectrum.shape
    laplacians = _laplacian(height), _laplacian(width)[: width // 2 + 1]
    arrays = _floats(spectrum), _floats(transfer), *laplacians
    mu = np.array(penalties, dtype=np.float32)
    blocks = min(BLOCKS, height)

    def solve(block: int) -> None:
        _solve_rows(*arrays, mu, *block_rows(block, blocks, height))

    for_each_block(solve, blocks, spectrum.numel())
    return spectrum


def _floats(field: Tensor) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Rows of a complex field as real, imaginary, real, …: the same memory."""
    return torch.view_as_real(field).flatten(1).numpy()


def _laplacian(length: int) -> np.ndarray[Any, np.dtype[np.float32]]:
    """Spectrum of one direction's ΨᵀΨ: 4 sin²(πk/length)."""
    return (4 * np.sin(np.pi * np.arange(length) / length) ** 2).astype(np.float32)


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy")
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _solve_pair(here, there, transfer, mu, rest):  # type: ignore[no-untyped-def]
    """The same for one pair; `here` and `there` may be the same cell."""
    first_re, first_im, second_re, second_im = _solved(
        here[0], here[1], there[0], there[1], transfer[0], transfer[1], mu[0], rest
    )
    here[0] = first_re
    here[1] = first_im
    there[0] = second_re
    there[1] = second_im


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
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


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _apart(row, real, imaginary):  # type: ignore[no-untyped-def]
    for j in range(real.size):
        real[j] = row[2 * j]
        imaginary[j] = row[2 * j + 1]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _together(row, real, imaginary):  # type: ignore[no-untyped-def]
    for j in range(real.size):
        row[2 * j] = real[j]
        row[2 * j + 1] = imaginary[j]


@numba.njit(cache=True, nogil=True, fastmath=FASTMATH, error_model="numpy", forceinline=True)
def _turn(row, turned):  # type: ignore[no-untyped-def]
    """Last cell first; unsigned, or the compiler minds indices below zero."""
    count = np.uintp(turned.size)
    for j in range(count):
        turned[j] = row[count - np.uintp(1) - j]
