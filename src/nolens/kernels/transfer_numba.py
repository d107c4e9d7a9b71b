"""The transfer function of plane layers on the CPU: one compiled pass over the rows."""

import numba
import numpy as np
import torch
from torch import Tensor

from nolens.kernels.threads import for_each_block
from nolens.kernels.transfer import LayerTransfer

_ROWS_PER_BLOCK = 32


def apply_transfer_(spectrum: Tensor, transfer: LayerTransfer) -> Tensor:
    """See `nolens.kernels.transfer.apply_transfer_`."""
    rows = [each[0].numpy() for each in (transfer.transverse, transfer.linear_turns)]
    columns = [each[1].numpy() for each in (transfer.transverse, transfer.linear_turns)]
    layers = np.array([transfer.lengths, transfer.squared_indices])
    indices = np.array(transfer.media, dtype=np.float32)
    pairs, limit = torch.view_as_real(spectrum).numpy(), transfer.limit

    def work(block: int) -> None:
        first = block * _ROWS_PER_BLOCK
        last = min(first + _ROWS_PER_BLOCK, len(pairs))
        _rows(pairs, rows[0], rows[1], columns[0], columns[1], layers, indices, limit, first, last)

    for_each_block(work, -(-len(pairs) // _ROWS_PER_BLOCK), spectrum.numel())
    return spectrum


@numba.njit(cache=True, nogil=True, fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
def _rows(  # type: ignore[no-untyped-def]
    pairs, row_p, row_turns, column_p, column_turns, layers, indices, limit, first, last
):
    count = len(column_p)
    squared = np.empty(count, dtype=np.float64)
    turns = np.empty(count, dtype=np.float64)
    passed = np.ones(count, dtype=np.float32)
    for i in range(first, last):
        across = row_p[i] * row_p[i]
        if across >= limit:
            pairs[i] = 0
            continue
        for j in range(count):
            squared[j] = across + column_p[j] * column_p[j]
            turns[j] = row_turns[i] + column_turns[j]
        for k in range(layers.shape[1]):
            length = layers[0, k]
            index = layers[1, k]
            for j in range(count):
                turns[j] += length * np.sqrt(max(index - squared[j], 0.0))
        if len(indices) > 1:
            _amplitudes(squared, indices, passed)
        for j in range(count):
            # Half turns of −½…½, so that the sine is monotonic and the series are short.
            half = 2.0 * turns[j]
            whole = np.floor(half + 0.5)
            odd = whole - 2.0 * np.floor(0.5 * whole)
            x = np.float32((half - whole) * np.pi)
            y = x * x
            sine = x * _sine(y)
            cosine = _cosine(y)
            sign = passed[j] * np.float32(1.0 - 2.0 * odd)
            sign = sign if squared[j] < limit else np.float32(0.0)
            sine *= sign
            cosine *= sign
            real = pairs[i, j, 0]
            imaginary = pairs[i, j, 1]
            pairs[i, j, 0] = real * cosine - imaginary * sine
            pairs[i, j, 1] = real * sine + imaginary * cosine


@numba.njit(inline="always", fastmath={"reassoc", "contract", "nsz"}, error_model="numpy")
def _amplitudes(squared, indices, passed):  # type: ignore[no-untyped-def]
    """Root of the power that passes all surfaces, for each p² of a row."""
    c = np.float32
    for j in range(len(passed)):
        passed[j] = c(1)
    for k in range(len(indices) - 1):
        before = indices[k]
        after = indices[k + 1]
        ratio = after / before
        other = before / after
        for j in range(len(passed)):
            p = c(squared[j])
            near = np.sqrt(max(before * before - p, c(1e-12)))
            far = np.sqrt(max(after * after - p, c(1e-12)))
            across = near + far
            along = ratio * near + other * far
            both = across * along
            passed[j] *= c(2) * near * far * (across * across + along * along) / (both * both)
    for j in range(len(passed)):
        passed[j] = np.sqrt(passed[j])


@numba.njit(inline="always")
def _sine(y):  # type: ignore[no-untyped-def]
    """sin(x)/x for |x| ≤ π/2 from y = x², by its Taylor series to x¹¹ (below 6e-8 there)."""
    c = np.float32
    return c(1) + y * (
        c(-1 / 6)
        + y * (c(1 / 120) + y * (c(-1 / 5040) + y * (c(1 / 362880) - y * c(1 / 39916800))))
    )


@numba.njit(inline="always")
def _cosine(y):  # type: ignore[no-untyped-def]
    """cos(x) for |x| ≤ π/2 from y = x², by its Taylor series to x¹² (below 7e-9 there)."""
    c = np.float32
    return c(1) + y * (
        c(-1 / 2)
        + y
        * (
            c(1 / 24)
            + y * (c(-1 / 720) + y * (c(1 / 40320) + y * (c(-1 / 3628800) + y * c(1 / 479001600))))
        )
    )
