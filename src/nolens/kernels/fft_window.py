"""Transforms of real fields of which a window matters, and the rest is zero or not wanted.

Rows outside the window are not transformed: half of all, for a sensor in a period of twice its
size.
"""

import torch
from torch import Tensor

from nolens.kernels.fft import irfft_rows, rfft_rows, transform_

Window = tuple[int, int, int, int]
"""top, left, height, width of a rectangle inside the period"""


def rfft2_window(
    inside: Tensor,
    corner: tuple[int, int],
    period: tuple[int, int],
    out: Tensor | None = None,
) -> Tensor:
    """Half spectrum of a real field that is zero outside a window.

    Parameters
    ----------
    inside
        The window, (…, height, width), no larger than the period.
    corner
        Row and column of its first cell; it goes on at the other side of the period.
    period
        (height, width) of the field.
    out
        Where the spectrum goes; None takes new memory, which costs as much as the transform.
    """
    height, width = period
    wide = inside.new_zeros((*inside.shape[:-1], width))
    _place(wide, inside, corner[1], -1)
    if inside.device.type != "cpu":
        field = inside.new_zeros((*inside.shape[:-2], *period))
        _place(field, wide, corner[0], -2)
        found: Tensor = torch.fft.rfft2(field)
        return found if out is None else out.copy_(found)
    lines = torch.from_numpy(rfft_rows(wide.numpy()))
    spectrum = lines
    if out is not None or lines.shape[-2] < height or corner[0] % height:
        size = (*lines.shape[:-2], height, lines.shape[-1])
        spectrum = lines.new_zeros(size) if out is None else out.zero_()
        _place(spectrum, lines, corner[0], -2)
    transform_(spectrum.numpy(), (-2,), forward=True)
    return spectrum


def irfft2_window_(spectrum: Tensor, window: Window, period: tuple[int, int]) -> Tensor:
    """Window of a real field from its half spectrum, whose memory is used.

    Parameters
    ----------
    spectrum
        (…, height, width // 2 + 1) of the period; what it holds afterwards means nothing.
    window
        Part of the field that is wanted, inside the period.
    period
        (height, width) of the field.
    """
    top, left, height, width = window
    if spectrum.device.type != "cpu":
        field: Tensor = torch.fft.irfft2(spectrum, s=period)
        return field[..., top : top + height, left : left + width]
    transform_(spectrum.numpy(), (-2,), forward=False)
    lines = irfft_rows(spectrum[..., top : top + height, :].numpy(), period[1])
    return torch.from_numpy(lines)[..., left : left + width]


def _place(large: Tensor, small: Tensor, start: int, axis: int) -> None:
    """Put one tensor into another along an axis, from a place on, around its end."""
    length, count = large.shape[axis], small.shape[axis]
    start %= length
    first = min(count, length - start)
    large.narrow(axis, start, first).copy_(small.narrow(axis, 0, first))
    if first < count:
        large.narrow(axis, 0, count - first).copy_(small.narrow(axis, first, count - first))
