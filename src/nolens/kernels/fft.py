"""Two-dimensional transforms: torch's, and scipy's (or ducc0's) where they are faster.

On the CPU, torch's are those of Intel's MKL on x86: they use all of the processor's vectors and
take half of scipy's time, but for columns of large planes, where they take twice as long and memory
for another plane. Those, and all where torch has no MKL, are handed to scipy without a copy, or to
ducc0 where that is installed (`docs/decisions/0001-admm-state-and-transforms.md`).
"""

import importlib
import math
from collections.abc import Iterator, Sequence
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


_DUCC = _ducc()
_MKL = bool(torch.backends.mkl.is_available())  # type: ignore[no-untyped-call]
_AXES = (-2, -1)
_PLANES_BY_MKL, _COLUMNS_BY_MKL = 2**21, 2**19
"""Complex numbers in a plane up to which MKL is the faster, both ways at once and along columns."""

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
    return _along(field, *_AXES, forward=True)


def ifft2_(spectrum: Tensor) -> Tensor:
    """Inverse of `fft2_` (scaled by one over the number of pixels), reusing memory."""
    return _along(spectrum, *_AXES, forward=False)


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
        _place(wide, spectrum[:, : columns - columns // 2], (0, 0))
        _place(wide, spectrum[:, columns - columns // 2 :], (0, -(columns // 2)))
        spectrum = wide.mul_(finer)
    part = _along(spectrum, -1, forward=False)[:, left : left + width]
    if finer == 1:
        field = _along(part, -2, forward=False)[top : top + height]
        return _squared(field) if squared else field
    # Rows between those of the spectrum are those of the shifted field.
    turns = torch.fft.fftfreq(rows, 1 / (2 * math.pi), dtype=torch.float64)[:, None]
    out = (part.real if squared else part).new_empty((height, width))
    for number in range(min(finer, height)):
        first, shift = divmod(top + number, finer)
        turn = torch.polar(torch.ones_like(turns), turns * (shift / finer)).to(part)
        needed = out[number::finer]
        field = _along(part * turn, -2, forward=False)[first : first + len(needed)]
        needed.copy_(_squared(field) if squared else field)
    return out


def rfft2(field: Tensor) -> Tensor:
    """Half spectrum of a real field over its last two axes."""
    if _is_torchs(field, _half(field.shape[-2:]), _PLANES_BY_MKL):
        spectrum: Tensor = torch.fft.rfft2(field)
        return spectrum
    return _along(_rfft_rows(field), -2, forward=True)


def irfft2(spectrum: Tensor, shape: tuple[int, int]) -> Tensor:
    """Real field of `shape` (height, width) from its half spectrum."""
    if spectrum.device.type != "cpu":
        field: Tensor = torch.fft.irfft2(spectrum, s=shape)
        return field
    return _irfft_rows(_along(spectrum, -2, forward=False, in_place=False), shape[1])


def rfft2_window(
    inside: Tensor,
    corner: tuple[int, int],
    padded: tuple[int, int],
    out: Tensor | None = None,
) -> Tensor:
    """Half spectrum of a real field that is zero outside a window.

    Where scipy transforms the columns, rows outside the window are not transformed.

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
    if _is_torchs(inside, _half(padded), _PLANES_BY_MKL):
        field = inside.new_zeros((*inside.shape[:-2], height, width))
        _place(field, inside, corner)
        spectrum: Tensor = torch.fft.rfft2(field)
        return spectrum if out is None else out.copy_(spectrum)
    wide = inside.new_zeros((*inside.shape[:-1], width))
    _place(wide, inside, (0, corner[1]))
    lines = _rfft_rows(wide)
    spectrum = lines
    if out is not None or lines.shape[-2] < height or corner[0] % height:
        size = (*lines.shape[:-2], height, lines.shape[-1])
        spectrum = lines.new_zeros(size) if out is None else out.zero_()
        _place(spectrum, lines, (corner[0], 0))
    return _along(spectrum, -2, forward=True)


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
    lines = _along(spectrum, -2, forward=False)[..., top : top + height, :]
    return _irfft_rows(lines, padded[1])[..., left : left + width]


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
    lines = _along(spectrum, -2, forward=False)[..., top : top + height, :]
    for each in factors:
        yield _irfft_rows(lines * each, padded[1])[..., left : left + width]


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


def _squared(field: Tensor) -> Tensor:
    return field.real.square().addcmul_(field.imag, field.imag)


def _half(shape: Sequence[int]) -> int:
    """Numbers in the half spectrum of a plane."""
    height, width = shape
    return height * (width // 2 + 1)


def _is_torchs(field: Tensor, numbers: int, at_most: int) -> bool:
    """Whether torch is the faster: on CUDA, and by MKL for so many numbers in a plane."""
    return field.device.type != "cpu" or (_MKL and numbers <= at_most)


def _along(field: Tensor, *axes: int, forward: bool, in_place: bool = True) -> Tensor:
    """Transform of a complex field along its rows, its columns or both, or its inverse.

    Parameters
    ----------
    field
        Of any strides.
    axes
        Over which.
    forward
        Whether it is the transform, or its inverse (scaled by one over the pixels of the axes).
    in_place
        Whether the field's memory may be used; it need not be.
    """
    at_most = _COLUMNS_BY_MKL if axes == (-2,) else _PLANES_BY_MKL
    if _is_torchs(field, math.prod(field.shape[-2:]), at_most):
        by_torch = torch.fft.fftn if forward else torch.fft.ifftn
        transformed: Tensor = by_torch(field, dim=axes)
        return transformed
    array, threads = field.numpy(), threads_for(field.numel())
    if _DUCC is not None:
        out = array if in_place else np.empty_like(array)
        inorm = 0 if forward else 2
        _DUCC.c2c(array, out=out, axes=axes, forward=forward, inorm=inorm, nthreads=threads)
    else:
        by_scipy = scipy.fft.fftn if forward else scipy.fft.ifftn
        out = by_scipy(array, axes=axes, overwrite_x=in_place, workers=threads)
    if not in_place:
        return torch.from_numpy(out)
    if not np.may_share_memory(out, array):
        array[...] = out
    return field


def _rfft_rows(field: Tensor) -> Tensor:
    """Half spectra of the rows of a real field on the CPU."""
    if _MKL:
        spectra: Tensor = torch.fft.rfft(field)
        return spectra
    array, threads = field.numpy(), threads_for(field.numel())
    if _DUCC is not None:
        return torch.from_numpy(_DUCC.r2c(array, axes=(-1,), nthreads=threads))
    return torch.from_numpy(scipy.fft.rfft(array, workers=threads))


def _irfft_rows(spectra: Tensor, width: int) -> Tensor:
    """Real rows of `width` pixels from their half spectra."""
    if spectra.device.type != "cpu" or _MKL:
        field: Tensor = torch.fft.irfft(spectra, n=width)
        return field
    array, threads = spectra.numpy(), threads_for(spectra.numel())
    if _DUCC is not None:
        return torch.from_numpy(
            _DUCC.c2r(array, axes=(-1,), lastsize=width, forward=False, inorm=2, nthreads=threads)
        )
    return torch.from_numpy(scipy.fft.irfft(array, n=width, workers=threads))


def _place(large: Tensor, small: Tensor, corner: tuple[int, int]) -> None:
    """Put planes into others from a corner on, around their edges."""
    rows, columns = (
        _spans(start, count, length)
        for start, count, length in zip(corner, small.shape[-2:], large.shape[-2:], strict=True)
    )
    for row, of_row in rows:
        for column, of_column in columns:
            large[..., row, column] = small[..., of_row, of_column]


def _spans(start: int, count: int, length: int) -> list[tuple[slice, slice]]:
    """Where lines from a start on lie, around the end, and which of them."""
    start %= length
    first = min(count, length - start)
    spans = [(slice(start, start + first), slice(0, first))]
    if first < count:
        spans.append((slice(0, count - first), slice(first, count)))
    return spans
