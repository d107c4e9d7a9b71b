"""Odd linear splines on the CPU: one compiled pass over the pixels."""

import numba
import numpy as np
from torch import Tensor

from nolens.kernels.threads import for_each_block

_PIXELS_PER_BLOCK = 1024


def odd_spline_(t: Tensor, knots: Tensor, masses: Tensor) -> Tensor:
    """See `nolens.kernels.spline.odd_spline_`; float32, channels last in memory."""
    count, channels = t.shape[:2]
    values = t.permute(0, 2, 3, 1).view(count, -1, channels).numpy()
    bends, weights = (
        each.detach()[..., 0, 0].transpose(0, 1).expand(count, -1, -1).contiguous().numpy()
        for each in (knots, masses)
    )
    pixels = values.shape[1]
    blocks = -(-pixels // _PIXELS_PER_BLOCK)

    def work(block: int) -> None:
        picture, part = divmod(block, blocks)
        first = part * _PIXELS_PER_BLOCK
        last = min(first + _PIXELS_PER_BLOCK, pixels)
        _pixels(values[picture, first:last], bends[picture], weights[picture])

    for_each_block(work, count * blocks, t.numel() // 8)
    return t


@numba.njit(cache=True, nogil=True, fastmath={"contract", "nsz", "nnan"}, error_model="numpy")
def _pixels(values, knots, masses):  # type: ignore[no-untyped-def]
    channels = values.shape[1]
    total = np.empty(channels, dtype=np.float32)
    for p in range(len(values)):
        for i in range(channels):
            total[i] = 0
        for k in range(len(knots)):
            for i in range(channels):
                knot = knots[k, i]
                total[i] += masses[k, i] * min(max(values[p, i], -knot), knot)
        for i in range(channels):
            values[p, i] = total[i]
