"""Laying a PSF over that of another distance: how far it is moved, and how much larger."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from nolens.kernels import irfft2, rfft2

Plane = NDArray[np.float64]

_LONGEST = 800
"""Pixels along the longer side; finer PSFs are averaged, as parts of a pixel are found anyway."""
_SMOOTH = 24.0
"""Width of the Gaussian, in pixels, whose smooth light does not count."""
_BLURS = (6.0, 3.0, 1.5, 0.7)
_STEPS = 12
_STILL = 1e-3
_EDGE = 4
_STEP = 0.005
"""Of the logarithm of the magnification, in the search."""
_SEARCHED = 0.5
"""Share of the work that the search is."""
NEARBY = (0.93, 1.07)
"""Magnifications to expect: 2 cm against far is 6 % through the paper's layers."""


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

    shift: tuple[float, float]
    magnification: float
    correlation: float


def register(
    pattern: Tensor,
    reference: Tensor,
    *,
    magnification: float | tuple[float, float] = NEARBY,
    tick: Callable[[float], None] | None = None,
) -> Registration:
    r"""Find shift and magnification of a PSF against another one.

    The whole-pixel shift is the peak of the cross-correlation; where the magnification is not
    known, the highest one over all in a range. From there on shift and the logarithm of
    the magnification are refined together by Gauss–Newton steps on the squared difference
    (`baker2004`), on PSFs blurred less and less, so that neither the fine structure's many
    minima nor the blur decide. What a blur found counts only if the PSFs are more alike there
    under the next smaller blur too: a blur as wide as the structure leaves nothing to lay over.

    Parameters
    ----------
    pattern, reference
        (channels, rows, columns), alike in size.
    magnification
        What is expected, or the least and largest one to search.
    tick
        Called with the share that is done, 0 to 1.
    """
    bin_by = math.ceil(max(pattern.shape[-2:]) / _LONGEST)
    one, other = (_fine_structure(each, bin_by) for each in (pattern, reference))
    least, largest = magnification if isinstance(magnification, tuple) else (magnification,) * 2
    ends = math.log(least), math.log(largest)
    spectrum, peaks = _spectrum(one), []
    scales = np.linspace(*ends, 1 + math.ceil((ends[1] - ends[0]) / _STEP)).tolist()
    for number, log_scale in enumerate(scales):
        if tick is not None:
            tick(_SEARCHED * number / len(scales))
        height, shift = _whole_shift(spectrum, _warped(other, np.zeros(2), log_scale))
        peaks.append((height, *shift, log_scale))
    found = np.array(max(peaks)[1:], dtype=float)
    blurred = [[ndimage.gaussian_filter(each, blur) for each in (one, other)] for blur in _BLURS]
    pairs = zip(blurred, [*blurred[1:], blurred[-1]], strict=True)
    for number, (this, finer) in enumerate(pairs):
        if tick is not None:
            tick(_SEARCHED + (1 - _SEARCHED) * number / len(blurred))
        refined = _refined(this[0], this[1], found)
        if _alike(finer[0], finer[1], refined) >= _alike(finer[0], finer[1], found):
            found = refined
    correlation = _alike(one, other, found)
    larger = math.exp(found[2])
    # Both were magnified about the middle of the averaged cells.
    beside = [
        whole // 2 - (bin_by * count - 1) / 2
        for whole, count in zip(pattern.shape[-2:], one.shape, strict=True)
    ]
    moved = [
        float(by) * bin_by + off * (larger - 1) for by, off in zip(found, beside, strict=False)
    ]
    return Registration((moved[0], moved[1]), larger, correlation)


def _fine_structure(psf: Tensor, bin_by: int) -> Plane:
    """All channels together, without what is smooth."""
    grey = psf.double().sum(dim=0)
    grey = nnf.avg_pool2d(grey[None, None], bin_by)[0, 0] if bin_by > 1 else grey
    plane: Plane = grey.numpy()
    rest: Plane = plane - ndimage.gaussian_filter(plane, _SMOOTH / bin_by, mode="nearest")
    return rest / max(float(np.abs(rest).max()), 1e-300)


def _spectrum(plane: Plane) -> Tensor:
    """On twice its size, so that nothing comes round."""
    rows, columns = plane.shape
    return rfft2(nnf.pad(torch.from_numpy(plane).float(), (0, columns, 0, rows)))


def _whole_shift(pattern: Tensor, reference: Plane) -> tuple[float, tuple[int, int]]:
    """Peak of the cross-correlation with a pattern's spectrum, and the cells it is moved by."""
    rows, columns = (2 * n for n in reference.shape)
    correlation = irfft2(pattern * _spectrum(reference).conj(), (rows, columns))
    row, column = divmod(int(correlation.argmax()), columns)
    half = rows // 2, columns // 2
    shift = (row + half[0]) % rows - half[0], (column + half[1]) % columns - half[1]
    return float(correlation.max()), shift


def _warped(reference: Plane, shift: NDArray[Any], log_scale: float) -> Plane:
    """The reference magnified about its middle, and moved."""
    scale = math.exp(-log_scale)
    middle = (np.array(reference.shape) - 1) / 2
    warped: Plane = ndimage.affine_transform(
        reference, np.array([scale, scale]), offset=middle - (middle + shift) * scale, order=3
    )
    return warped


def _inside(shape: tuple[int, ...], shift: NDArray[Any], log_scale: float) -> NDArray[np.bool_]:
    """Cells whose place lies within the reference, and not at the picture's edge."""
    scale = math.exp(-log_scale)
    lines = []
    for count, by in zip(shape, shift, strict=True):
        middle = (count - 1) / 2
        cell = np.arange(count)
        place = (cell - middle - by) * scale + middle
        kept = (place >= _EDGE) & (place <= count - 1 - _EDGE)
        lines.append(kept & (cell >= _EDGE) & (cell < count - _EDGE))
    both: NDArray[np.bool_] = np.logical_and.outer(lines[0], lines[1])
    return both


def _alike(pattern: Plane, reference: Plane, found: NDArray[Any]) -> float:
    """Correlation of a pattern and the reference as it was found to lie."""
    inside = _inside(pattern.shape, found[:2], found[2])
    a, b = pattern[inside], _warped(reference, found[:2], found[2])[inside]
    size = math.sqrt(float((a * a).sum() * (b * b).sum()))
    return float((a * b).sum()) / size if size > 0 else 0.0


def _refined(pattern: Plane, reference: Plane, start: NDArray[Any]) -> NDArray[Any]:
    """Gauss–Newton steps on (row shift, column shift, log magnification) and a gain."""
    found = start.copy()
    middle = [(n - 1) / 2 for n in pattern.shape]
    for _ in range(_STEPS):
        warped = _warped(reference, found[:2], found[2])
        inside = _inside(pattern.shape, found[:2], found[2])
        if inside.sum() < 16:
            break
        slopes = np.gradient(warped)
        across = [
            np.arange(n, dtype=float) - m - s
            for n, m, s in zip(pattern.shape, middle, found[:2], strict=True)
        ]
        outward = across[0][:, None] * slopes[0] + across[1] * slopes[1]
        columns = [warped, -slopes[0], -slopes[1], -outward]
        system = np.stack([each[inside] for each in columns], axis=1)
        solution = np.linalg.lstsq(system, pattern[inside], rcond=None)[0]
        if not solution[0] > 0:
            break
        step = solution[1:] / solution[0]
        found = found + step
        if max(abs(step[0]), abs(step[1]), abs(step[2]) * max(middle)) < _STILL:
            break
    return found
