"""How far one PSF is moved against another one, where the two overlap."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

Plane = NDArray[np.float64]
Cells = tuple[float, float]

_SMOOTH = 24.0
"""Width of the Gaussian, in pixels, whose smooth light does not count: lenslets are closer."""
_TAPER = 16
"""Pixels along which an overlap fades out at its edges."""
_FINE, _FINER = 0.25, 0.025
"""Steps of the two searches between pixels."""
_LEAST_CELLS = 24


@dataclass(frozen=True)
class Match:
    """Where one PSF lies on another one.

    Parameters
    ----------
    moved
        (row, column) in pixels by which the second one is moved against the first.
    correlation
        Of what both show, without smooth light; 1 if they are alike.
    cells
        How many both show.
    """

    moved: Cells
    correlation: float
    cells: int

    def scaled(self, by: int) -> "Match":
        """The same in pixels that are so many times finer."""
        return Match(
            (by * self.moved[0], by * self.moved[1]), self.correlation, by * by * self.cells
        )


def fine_structure(pattern: Plane) -> Plane:
    """The PSF without what is smooth: glow and vignetting are no landmarks."""
    rest: Plane = pattern - ndimage.gaussian_filter(pattern, _SMOOTH, mode="nearest")
    return rest


def matched(one: Plane, other: Plane, expected: Cells, search: float) -> Match | None:
    """Find the shift of one PSF against another one near where it is expected.

    The peak of the cross-correlation within the search, then the same between pixels by the
    matrix form of the Fourier transform (`guizar2008`), in the overlap at that shift.

    Parameters
    ----------
    one, other
        Fine structure of the PSFs, alike in size.
    expected
        Pixels by which the second is moved, as far as is known.
    search
        Pixels around it, along rows and columns.

    Returns
    -------
    Match or None
        None where they hardly overlap.
    """
    found = _whole_cells(one, other, (round(expected[0]), round(expected[1])), math.ceil(search))
    if found is None:
        return None
    parts = _overlap(one, other, found)
    if parts is None:
        return None
    spectrum = _cross_spectrum(*parts)
    shape = (parts[0].shape[0], parts[0].shape[1])
    part = _between_cells(spectrum, shape, (0.0, 0.0), 1.0, _FINE)
    part = _between_cells(spectrum, shape, part, _FINE, _FINER)
    return Match(
        (found[0] + part[0], found[1] + part[1]), _correlation(*parts, part), parts[0].size
    )


def _overlap(one: Plane, other: Plane, moved: tuple[int, int]) -> tuple[Plane, Plane] | None:
    """What both show, when the second is moved by whole cells: one[i] beside other[i + moved]."""
    here, there = [], []
    for count, by in zip(one.shape, moved, strict=True):
        if count - abs(by) < _LEAST_CELLS:
            return None
        here.append(slice(max(0, -by), count - max(0, by)))
        there.append(slice(max(0, by), count - max(0, -by)))
    return one[here[0], here[1]], other[there[0], there[1]]


def _whole_cells(
    one: Plane, other: Plane, expected: tuple[int, int], search: int
) -> tuple[int, int] | None:
    """Peak of the cross-correlation within so many cells of the expected shift."""
    parts = _overlap(one, other, expected)
    if parts is None:
        return None
    shape = (parts[0].shape[0], parts[0].shape[1])
    across = fft.ifft2(_cross_spectrum(*parts)).real
    reach = [min(search, count // 2 - 1) for count in shape]
    near = np.roll(across, (reach[0], reach[1]), (0, 1))[: 2 * reach[0] + 1, : 2 * reach[1] + 1]
    row, column = divmod(int(near.argmax()), near.shape[1])
    return expected[0] + row - reach[0], expected[1] + column - reach[1]


def _cross_spectrum(one: Plane, other: Plane) -> NDArray[np.complex128]:
    """Spectrum whose inverse has its peak where `other` is moved against `one`."""
    window = np.outer(*(_fading(count) for count in one.shape))
    spectra = [fft.fft2((each - each.mean()) * window) for each in (one, other)]
    both: NDArray[np.complex128] = spectra[0].conj() * spectra[1]
    return both


def _fading(count: int) -> Plane:
    place = np.minimum(np.arange(count), np.arange(count)[::-1]) + 0.5
    edge = min(_TAPER, count / 4)
    line: Plane = np.sin(np.pi / 2 * np.clip(place / edge, 0, 1)) ** 2
    return line


def _between_cells(
    spectrum: NDArray[np.complex128],
    shape: tuple[int, int],
    start: Cells,
    reach: float,
    step: float,
) -> Cells:
    """Peak of the cross-correlation on a finer grid around a place, and between its points."""
    steps = np.arange(-round(reach / step), round(reach / step) + 1) * step
    rows = np.exp(2j * np.pi * np.outer(start[0] + steps, fft.fftfreq(shape[0])))
    columns = np.exp(2j * np.pi * np.outer(fft.fftfreq(shape[1]), start[1] + steps))
    across = (rows @ spectrum @ columns).real
    row, column = divmod(int(across.argmax()), across.shape[1])
    return (
        start[0] + float(steps[row]) + step * _top(across[:, column], row),
        start[1] + float(steps[column]) + step * _top(across[row], column),
    )


def _top(line: Plane, at: int) -> float:
    """Top of the parabola through three points, in steps from the middle one."""
    if not 0 < at < len(line) - 1:
        return 0.0
    before, middle, after = (float(each) for each in line[at - 1 : at + 2])
    curve = before - 2 * middle + after
    return (before - after) / (2 * curve) if curve < 0 else 0.0


def _correlation(one: Plane, other: Plane, moved: Cells) -> float:
    """Of two overlapping patterns, the second moved back by a part of a cell."""
    inner = (slice(2, -2), slice(2, -2))
    back = ndimage.shift(other, (-moved[0], -moved[1]), order=3, mode="nearest")[inner]
    here = one[inner] - one[inner].mean()
    back = back - back.mean()
    size = math.sqrt(float((here**2).sum() * (back**2).sum()))
    return float((here * back).sum()) / size if size > 0 else 0.0
