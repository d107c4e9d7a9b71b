"""Two-dimensional transforms: scipy (or ducc0, where installed) on the CPU, torch on CUDA.

torch's own CPU transforms take 1.6 to 2 times as long as scipy's at the sizes of a sensor,
so tensors on the CPU are handed to scipy without a copy. Of real fields of which a window matters,
and the rest is zero or not needed, rows outside the window are not transformed: half of all, for a
sensor in a padded shape of twice its size.
"""

import importlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import scipy.fft
import torch
from torch import Tensor

from nolens.kernels.threads import threads_for


def _ducc() -> Any | None:
    try:
        return importlib.import_module("ducc0.fft")
    except ImportError:
        return None


Array = np.ndarray[Any, Any]

_DUCC = _ducc()
_AXES = (-2, -1)

Window = tuple[int, int, int, int]
"""top, left, height, width of a rectangle inside the padded shape"""


def fast_length(at_least: int, *, of_rows: bool) -> int:
    """Smallest transform length from `at_least` upwards that is even and fast.

    Lengths are products of 2, 3, 5, 7 and 11. For rows, multiples of 256 are passed over: rows
    whose stride is a large power of two fall into the same cache sets, and the transform along
    the columns then takes longer than at the next length.

    Parameters
    ----------
    at_least
        Number of pixels that the padded shape must hold.
    of_rows
        Whether it is the length of the rows, which is the stride along the columns.
    """
    length = max(2, at_least)
    while True:
        length = int(scipy.fft.next_fast_len(length))
        if length % 2 == 0 and not (of_rows and length % 256 == 0):
            return length
        length += 1


def fft2_(field: Tensor) -> Tensor:
    """Transform a complex field over its last two axes, reusing its memory where possible."""
    return _complex(field, forward=True)


def ifft2_(spectrum: Tensor) -> Tensor:
    """Inverse of `fft2_` (scaled by one over the number of pixels), reusing memory."""
    return _complex(spectrum, forward=False)


def ifft2_window(
    spectrum: Tensor, window: Window, finer: int = 1, *, squared: bool = False
) -> Tensor:
    """Window of the inverse of `fft2_` on a finer grid: no row or column is transformed in vain.

    Parameters
    ----------
    spectrum
        (rows, columns); with `finer` = 1 its memory may be used.
    window
        Part of the result that is needed, inside (finer · rows, finer · columns).
    finer
        Number of samples to give for one, in either direction.
    squared
        Whether to give the squared magnitude, which is real.
    """
    top, left, height, width = window
    rows, columns = spectrum.shape
    if finer > 1:
        wide = spectrum.new_zeros((rows, finer * columns))
        _place(wide, spectrum[:, : columns - columns // 2], 0, -1)
        _place(wide, spectrum[:, columns - columns // 2 :], -(columns // 2), -1)
        spectrum = wide.mul_(finer)
    part = _inverse_(spectrum, -1)[:, left : left + width]
    if finer == 1:
        field = _inverse_(part, -2)[top : top + height]
        return _squared(field) if squared else field
    # Rows between those of the spectrum are those of the shifted field.
    turns = torch.fft.fftfreq(rows, 1 / (2 * math.pi), dtype=torch.float64)[:, None]
    out = (part.real if squared else part).new_empty((height, width))
    for number in range(min(finer, height)):
        first, shift = divmod(top + number, finer)
        turn = torch.polar(torch.ones_like(turns), turns * (shift / finer)).to(part)
        needed = out[number::finer]
        field = _inverse_(part * turn, -2)[first : first + len(needed)]
        needed.copy_(_squared(field) if squared else field)
    return out


def rfft2(field: Tensor) -> Tensor:
    """Half spectrum of a real field over its last two axes."""
    if field.device.type != "cpu":
        spectrum: Tensor = torch.fft.rfft2(field)
        return spectrum
    array = field.numpy()
    if _DUCC is not None:
        return torch.from_numpy(_DUCC.r2c(array, axes=_AXES, nthreads=threads_for(array.size)))
    return torch.from_numpy(scipy.fft.rfft2(array, workers=threads_for(array.size)))


def irfft2(spectrum: Tensor, shape: tuple[int, int]) -> Tensor:
    """Real field of `shape` (height, width) from its half spectrum."""
    if spectrum.device.type != "cpu":
        field: Tensor = torch.fft.irfft2(spectrum, s=shape)
        return field
    array = spectrum.numpy()
    if _DUCC is not None:
        result = _DUCC.c2r(
            array,
            axes=_AXES,
            lastsize=shape[1],
            forward=False,
            inorm=2,
            nthreads=threads_for(array.size),
        )
        return torch.from_numpy(result)
    return torch.from_numpy(scipy.fft.irfft2(array, s=shape, workers=threads_for(array.size)))


def rfft2_window(
    inside: Tensor,
    corner: tuple[int, int],
    padded: tuple[int, int],
    out: Tensor | None = None,
) -> Tensor:
    """Half spectrum of a real field that is zero outside a window.

    Parameters
    ----------
    inside
        The window, (…, height, width), no larger than the padded shape.
    corner
        Row and column of its first pixel; it goes on at the other side of the padded shape.
    padded
        (height, width) of the field.
    out
        Where the spectrum goes; None takes new memory, which costs as much as the transform.
    """
    height, width = padded
    wide = inside.new_zeros((*inside.shape[:-1], width))
    _place(wide, inside, corner[1], -1)
    if inside.device.type != "cpu":
        field = inside.new_zeros((*inside.shape[:-2], *padded))
        _place(field, wide, corner[0], -2)
        result: Tensor = torch.fft.rfft2(field)
        return result if out is None else out.copy_(result)
    lines = torch.from_numpy(_rfft_rows(wide.numpy()))
    spectrum = lines
    if out is not None or lines.shape[-2] < height or corner[0] % height:
        size = (*lines.shape[:-2], height, lines.shape[-1])
        spectrum = lines.new_zeros(size) if out is None else out.zero_()
        _place(spectrum, lines, corner[0], -2)
    _transform_(spectrum.numpy(), (-2,), forward=True)
    return spectrum


def irfft2_window_(spectrum: Tensor, window: Window, padded: tuple[int, int]) -> Tensor:
    """Window of a real field from its half spectrum, whose memory is used.

    Parameters
    ----------
    spectrum
        (…, height, width // 2 + 1) of the padded shape; what it holds afterwards means nothing.
    window
        Part of the field that is needed, inside the padded shape.
    padded
        (height, width) of the field.
    """
    top, left, height, width = window
    if spectrum.device.type != "cpu":
        field: Tensor = torch.fft.irfft2(spectrum, s=padded)
        return field[..., top : top + height, left : left + width]
    _transform_(spectrum.numpy(), (-2,), forward=False)
    lines = _irfft_rows(spectrum[..., top : top + height, :].numpy(), padded[1])
    return torch.from_numpy(lines)[..., left : left + width]


def irfft2_windows_(
    spectrum: Tensor, factors: Tensor, window: Window, padded: tuple[int, int]
) -> Iterator[Tensor]:
    """Windows of real fields whose half spectra are one, times factors of its columns.

    The columns are transformed once for all of them.

    Parameters
    ----------
    spectrum
        As `irfft2_window_` takes it.
    factors
        (number, width // 2 + 1): of every field, one for each column.
    window, padded
        As `irfft2_window_` takes them.
    """
    top, left, height, width = window
    lines = _inverse_(spectrum, -2)[..., top : top + height, :]
    for each in factors:
        if lines.device.type == "cpu":
            field = torch.from_numpy(_irfft_rows((lines * each).numpy(), padded[1]))
        else:
            field = torch.fft.irfft(lines * each, n=padded[1])
        yield field[..., left : left + width]


def in_large_pages(tensor: Tensor) -> Tensor:
    """The same values in memory of numpy's, which asks the system for large pages.

    Transforms along columns touch a new page at every element; with small pages that costs more
    than the transform. Tensors on CUDA are handed back as they are.
    """
    if tensor.device.type != "cpu":
        return tensor
    array = np.empty(tensor.shape, dtype=tensor.numpy().dtype)
    array[...] = tensor.numpy()
    return torch.from_numpy(array)


def _transform_(array: Array, axes: tuple[int, ...], *, forward: bool) -> None:
    """Transform a complex array on the CPU over some of its axes, in place.

    Parameters
    ----------
    array
        Of any strides.
    axes
        Over which.
    forward
        Whether it is the transform, or its inverse (scaled by one over the pixels of the axes).
    """
    threads = threads_for(array.size)
    if _DUCC is not None:
        _DUCC.c2c(
            array,
            out=array,
            axes=axes,
            forward=forward,
            inorm=0 if forward else 2,
            nthreads=threads,
        )
        return
    transform = scipy.fft.fftn if forward else scipy.fft.ifftn
    result = transform(array, axes=axes, overwrite_x=True, workers=threads)
    if not np.may_share_memory(result, array):
        array[...] = result


def _squared(field: Tensor) -> Tensor:
    return field.real.square().addcmul_(field.imag, field.imag)


def _inverse_(spectrum: Tensor, axis: int) -> Tensor:
    """Inverse transform over one axis, in its memory where that is the processor's."""
    if spectrum.device.type != "cpu":
        field: Tensor = torch.fft.ifft(spectrum, dim=axis)
        return field
    _transform_(spectrum.numpy(), (axis,), forward=False)
    return spectrum


def _rfft_rows(array: Array) -> Array:
    """Half spectra of the rows of a real array on the CPU."""
    threads = threads_for(array.size)
    if _DUCC is not None:
        return np.asarray(_DUCC.r2c(array, axes=(-1,), nthreads=threads))
    return np.asarray(scipy.fft.rfft(array, axis=-1, workers=threads))


def _irfft_rows(spectra: Array, width: int) -> Array:
    """Real rows of `width` pixels from their half spectra, on the CPU."""
    threads = threads_for(spectra.size)
    if _DUCC is not None:
        return np.asarray(
            _DUCC.c2r(spectra, axes=(-1,), lastsize=width, forward=False, inorm=2, nthreads=threads)
        )
    return np.asarray(scipy.fft.irfft(spectra, n=width, axis=-1, workers=threads))


def _complex(field: Tensor, *, forward: bool) -> Tensor:
    if field.device.type != "cpu":
        out: Tensor = torch.fft.fft2(field) if forward else torch.fft.ifft2(field)
        return out
    _transform_(field.numpy(), _AXES, forward=forward)
    return field


def _place(large: Tensor, small: Tensor, start: int, axis: int) -> None:
    """Put one tensor into another along an axis, from a place on, around its end."""
    length, count = large.shape[axis], small.shape[axis]
    start %= length
    first = min(count, length - start)
    large.narrow(axis, start, first).copy_(small.narrow(axis, 0, first))
    if first < count:
        large.narrow(axis, 0, count - first).copy_(small.narrow(axis, first, count - first))
