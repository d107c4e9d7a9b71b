"""Where one PSF lies on another: the shift of overlapping parts, and shift with magnification."""

import math
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from scipy import fft, ndimage
from torch import Tensor

from nolens.evaluate.registration import FREEDOMS, Plane, alike, refined
from nolens.kernels import irfft2, rfft2
from nolens.progress import ProgressCallback

Shift = tuple[float, float]
"""(row, column), in pixels."""

_SMOOTH = 24.0
"""Width of the Gaussian, in pixels, whose smooth light does not count: lenslets are closer."""
_TAPER = 16
"""Pixels along which an overlap fades out at its edges."""
_FINE, _FINER = 0.25, 0.025
"""Steps of the two searches between pixels."""
_LEAST_OVERLAP = 24
"""Pixels along each side that an overlap must have."""
_LONGEST = 800
"""Pixels along the longer side; finer PSFs are averaged, as parts of a pixel are found anyway."""
_BLURS = (6.0, 3.0, 1.5, 0.7)
_SEARCHED_LONGEST, _SEARCH_STEP = 400, 2.0
"""The same in the search for the magnification, and pixels by which its steps move the ends of that
side."""
_SEARCH_FRACTION = 0.5
"""Of the work."""
NEARBY = (0.93, 1.07)
"""Magnifications to expect: 2 cm against far is 6 % through the paper's layers."""


@dataclass(frozen=True)
class Match:
    """Where one PSF lies on another one.

    Parameters
    ----------
    shift
        (row, column) in pixels of the second one against the first.
    correlation
        Of the overlap, without smooth light; 1 if both are alike.
    pixels
        How many the overlap has.
    """

    shift: Shift
    correlation: float
    pixels: int

    def scaled(self, by: int) -> "Match":
        """The same in pixels that are so many times finer."""
        return Match(
            (by * self.shift[0], by * self.shift[1]), self.correlation, by * by * self.pixels
        )


def fine_structure(psf: Plane, smooth: float = _SMOOTH) -> Plane:
    """The PSF without what is smooth: glow and vignetting are no landmarks."""
    rest: Plane = psf - ndimage.gaussian_filter(psf, smooth, mode="nearest")
    return rest


def match_overlap(one: Plane, other: Plane, expected: Shift, search: float) -> Match | None:
    """Find the shift of one PSF against another one near where it is expected.

    The peak of the cross-correlation within the search, then the same between pixels by the
    matrix form of the Fourier transform (`guizar2008`), in the overlap at that shift.

    Parameters
    ----------
    one, other
        Fine structure of the PSFs, alike in size.
    expected
        Shift of the second one, as far as is known.
    search
        Pixels around it, along rows and columns.

    Returns
    -------
    Match or None
        None where they hardly overlap.
    """
    whole = _whole_shift(one, other, (round(expected[0]), round(expected[1])), math.ceil(search))
    parts = None if whole is None else _overlap(one, other, whole)
    if whole is None or parts is None:
        return None
    spectrum = _cross_spectrum(*parts)
    part = _fractional_shift(spectrum, parts[0].shape, (0.0, 0.0), 1.0, _FINE)
    part = _fractional_shift(spectrum, parts[0].shape, part, _FINE, _FINER)
    inner = (slice(2, -2), slice(2, -2))
    back = ndimage.shift(parts[1], (-part[0], -part[1]), order=3, mode="nearest")[inner]
    here = parts[0][inner]
    correlation = _normalised_product(here - here.mean(), back - back.mean())
    return Match((whole[0] + part[0], whole[1] + part[1]), correlation, parts[0].size)


def _overlap(one: Plane, other: Plane, shift: tuple[int, int]) -> tuple[Plane, Plane] | None:
    """Overlap of both for a shift of the second by whole pixels: one[i], other[i + shift]."""
    here, there = [], []
    for count, by in zip(one.shape, shift, strict=True):
        if count - abs(by) < _LEAST_OVERLAP:
            return None
        here.append(slice(max(0, -by), count - max(0, by)))
        there.append(slice(max(0, by), count - max(0, -by)))
    return one[here[0], here[1]], other[there[0], there[1]]


def _whole_shift(
    one: Plane, other: Plane, expected: tuple[int, int], search: int
) -> tuple[int, int] | None:
    """Peak of the cross-correlation within so many pixels of the expected shift."""
    parts = _overlap(one, other, expected)
    if parts is None:
        return None
    across = fft.ifft2(_cross_spectrum(*parts)).real
    extent = [min(search, count // 2 - 1) for count in across.shape]
    near = np.roll(across, extent, (0, 1))[: 2 * extent[0] + 1, : 2 * extent[1] + 1]
    row, column = divmod(int(near.argmax()), near.shape[1])
    return expected[0] + row - extent[0], expected[1] + column - extent[1]


def _cross_spectrum(one: Plane, other: Plane) -> NDArray[np.complex128]:
    """Spectrum whose inverse has its peak at the shift of `other` against `one`."""
    window = np.outer(*(_taper(count) for count in one.shape))
    spectra = [fft.fft2((each - each.mean()) * window) for each in (one, other)]
    both: NDArray[np.complex128] = spectra[0].conj() * spectra[1]
    return both


def _taper(count: int) -> Plane:
    """Window that rises as sin² at both ends."""
    place = np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5
    edge = min(_TAPER, count / 4)
    line: Plane = np.sin(np.pi / 2 * np.clip(place / edge, 0, 1)) ** 2
    return line


def _fractional_shift(
    spectrum: NDArray[np.complex128],
    shape: tuple[int, ...],
    start: Shift,
    extent: float,
    step: float,
) -> Shift:
    """Peak of the cross-correlation on a finer grid around a place, and between its points."""
    steps = np.arange(-round(extent / step), round(extent / step) + 1) * step
    rows = np.exp(2j * np.pi * np.outer(start[0] + steps, fft.fftfreq(shape[0])))
    columns = np.exp(2j * np.pi * np.outer(fft.fftfreq(shape[1]), start[1] + steps))
    across = (rows @ spectrum @ columns).real
    row, column = divmod(int(across.argmax()), across.shape[1])
    return (
        start[0] + float(steps[row]) + step * _parabola_top(across[:, column], row),
        start[1] + float(steps[column]) + step * _parabola_top(across[row], column),
    )


def _parabola_top(line: Plane, at: int) -> float:
    """Top of the parabola through three points, in steps from the middle one."""
    if not 0 < at < len(line) - 1:
        return 0.0
    before, middle, after = (float(each) for each in line[at - 1 : at + 2])
    curve = before - 2 * middle + after
    return (before - after) / (2 * curve) if curve < 0 else 0.0


def _normalised_product(one: Plane, other: Plane) -> float:
    """⟨one, other⟩ / (‖one‖ ‖other‖); 0 where one of them is zero."""
    size = math.sqrt(float((one * one).sum() * (other * other).sum()))
    return float((one * other).sum()) / size if size > 0 else 0.0


@dataclass(frozen=True)
class Registration:
    """How one PSF lies on another one.

    Parameters
    ----------
    shift
        (row, column) in pixels by which it is moved.
    magnification
        How much larger it is, about its zero shift, the pixel (rows // 2, columns // 2).
    correlation
        Of the two PSFs' fine structure, once they lie on each other: 1 if they are alike.
    """

    shift: Shift
    magnification: float
    correlation: float


def register(
    psf: Tensor,
    reference: Tensor,
    *,
    magnification: float | tuple[float, float] = NEARBY,
    progress: ProgressCallback | None = None,
) -> Registration:
    r"""Find shift and magnification of a PSF against another one.

    The whole-pixel shift is the peak of the cross-correlation; where the magnification is not
    known, the highest one over all in a range, on larger pixels. From there on shift and the
    logarithm of the magnification are refined together by Gauss–Newton steps on the squared
    difference (`baker2004`), on PSFs blurred less and less, so that neither the fine structure's
    many minima nor the blur decide. The result of a blur counts only if the PSFs are more alike
    there under the next smaller blur too: a blur as wide as the structure leaves nothing to lay
    over.

    Parameters
    ----------
    psf, reference
        (channels, rows, columns), alike in size.
    magnification
        What is expected, or the least and largest one to search.
    progress
        Called with the fraction that is done, 0 to 1.
    """
    bin_by = math.ceil(max(psf.shape[-2:]) / _LONGEST)
    one, other = (_landmarks(each, bin_by) for each in (psf, reference))
    least, largest = magnification if isinstance(magnification, tuple) else (magnification,) * 2
    ends = math.log(least), math.log(largest)
    by = math.ceil(max(one.shape) / _SEARCHED_LONGEST)
    coarse = _averaged(one, by)
    spectrum, peaks = _padded_spectrum(coarse), []
    splines = ndimage.spline_filter(_averaged(other, by), order=3, mode="mirror")
    step = 2 * _SEARCH_STEP / max(coarse.shape)
    scales = np.linspace(*ends, 1 + math.ceil((ends[1] - ends[0]) / step)).tolist()
    for number, log_scale in enumerate(scales):
        if progress is not None:
            progress(_SEARCH_FRACTION * number / len(scales))
        matrix = _magnifying(coarse.shape, log_scale)
        warped = ndimage.affine_transform(
            splines, matrix[:2, :2], offset=matrix[:2, 2], order=3, prefilter=False
        )
        peaks.append((*_correlation_peak(spectrum, warped), log_scale))
    _, start, log_scale = max(peaks)
    matrix = _magnifying(one.shape, log_scale)
    matrix[:2, 2] -= matrix[0, 0] * by * np.array(start)
    blurred = [[ndimage.gaussian_filter(each, blur) for each in (one, other)] for blur in _BLURS]
    pairs = zip(blurred, [*blurred[1:], blurred[-1]], strict=True)
    for number, (this, finer) in enumerate(pairs):
        if progress is not None:
            progress(_SEARCH_FRACTION + (1 - _SEARCH_FRACTION) * number / len(blurred))
        better, _ = refined(this[0], this[1], matrix, FREEDOMS["magnified"], offset=False)
        if alike(finer[0], finer[1], better) >= alike(finer[0], finer[1], matrix):
            matrix = better
    scale = 1 / float(matrix[0, 0])
    moved = [
        ((count - 1) / 2 - at) * scale - (count - 1) / 2
        for count, at in zip(one.shape, matrix[:2, 2], strict=True)
    ]
    # Both were magnified about the middle of the averaged pixels.
    beside = [
        whole // 2 - (bin_by * count - 1) / 2
        for whole, count in zip(psf.shape[-2:], one.shape, strict=True)
    ]
    row, column = (
        float(by) * bin_by + off * (scale - 1) for by, off in zip(moved, beside, strict=True)
    )
    return Registration((row, column), scale, alike(one, other, matrix))


def _landmarks(psf: Tensor, bin_by: int) -> Plane:
    """Fine structure of all channels together, binned; its largest value is 1."""
    grey = _averaged(psf.double().sum(dim=0).numpy(), bin_by)
    rest = fine_structure(grey, _SMOOTH / bin_by)
    return rest / max(float(np.abs(rest).max()), 1e-300)


def _averaged(plane: Plane, by: int) -> Plane:
    """Means over by×by pixels, without rows and columns that fill none."""
    if by == 1:
        return plane
    means: Plane = nnf.avg_pool2d(torch.from_numpy(plane)[None, None], by)[0, 0].numpy()
    return means


def _padded_spectrum(plane: Plane) -> Tensor:
    """On twice its size, so that nothing comes round."""
    rows, columns = plane.shape
    return rfft2(nnf.pad(torch.from_numpy(plane).float(), (0, columns, 0, rows)))


def _correlation_peak(spectrum: Tensor, reference: Plane) -> tuple[float, tuple[int, int]]:
    """Peak of the cross-correlation with a PSF's spectrum, and its shift in whole pixels."""
    rows, columns = (2 * n for n in reference.shape)
    correlation = irfft2(spectrum * _padded_spectrum(reference).conj(), (rows, columns))
    row, column = divmod(int(correlation.argmax()), columns)
    half = rows // 2, columns // 2
    shift = (row + half[0]) % rows - half[0], (column + half[1]) % columns - half[1]
    return float(correlation.max()), shift


def _magnifying(shape: tuple[int, ...], log_scale: float) -> Plane:
    """Homography from a PSF's pixels to those of the reference, magnified about its middle."""
    by = math.exp(-log_scale)
    rows, columns = ((count - 1) / 2 * (1 - by) for count in shape)
    return np.array([[by, 0, rows], [0, by, columns], [0, 0, 1]])
