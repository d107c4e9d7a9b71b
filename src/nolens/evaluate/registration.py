"""Where one picture lies on another: shift, similarity or homography, and how sure that is."""

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from scipy import fft, linalg, ndimage
from torch import Tensor

Plane = NDArray[np.float64]
Motion = Literal["none", "shift", "similarity", "homography"]
"""What may differ: nothing; the place; also scale and rotation; also a tilt."""

_LONGEST = 800
"""Pixels along the longer side; finer pictures are averaged, as parts of a pixel are found."""
_COARSEST = 48
_SMOOTH = 1 / 8
"""Width of the Gaussian, in longer sides, whose smooth light does not count: vignetting."""
_EDGE = 4
_STEPS = 20
_CONVERGED = 1e-3
_SCALES = np.geomspace(0.87, 1.15, 7)
_ANGLES = np.radians(np.linspace(-9, 9, 7))
_LEAST_OVERLAP = 0.4
_BLOCKS = 6
_FINE = 1 / 40
"""Width, in longer sides, up to which structure is fine: other pictures are not alike in it."""
_SIDE, _PEAK = 8, 12.0
"""Pixels around the peak of the cross-correlation, and its height over all else that shows the same
scene. Photographs of other scenes reach 11, blurred reconstructions of this one 19 or more."""
_NEAR = 0.02


def _generators() -> Plane:
    """Of homographies, as changes of (row, column, 1): shifts, scale, rotation, and the rest."""
    basis = np.zeros((8, 3, 3))
    basis[0, 0, 2] = basis[1, 1, 2] = 1
    basis[2, 0, 0] = basis[2, 1, 1] = 1
    basis[3, 0, 1], basis[3, 1, 0] = 1, -1
    basis[4, 0, 0], basis[4, 1, 1] = 1, -1
    basis[5, 0, 1] = basis[5, 1, 0] = 1
    basis[6, 2, 0] = basis[7, 2, 1] = 1
    return basis


_GENERATORS = _generators()
FREEDOMS = {"none": 0, "shift": 2, "magnified": 3, "similarity": 4, "homography": 8}
"""How many of the generators each motion has; PSFs are also magnified without a turn."""


@dataclass(frozen=True)
class Registration:
    """Where a picture's pixels lie on another one, the truth.

    Parameters
    ----------
    matrix
        Homography (3, 3) from (row, column, 1) of the picture to that of the truth, in pixels.
    motion
        What was free.
    correlation
        Of both, without their smooth light, once they lie on each other: 1 if they are alike.
    error_px
        Standard error of the place, over all pixels, in pixels of the picture; NaN where nothing
        was free. Residuals are taken as dependent within each of 36 parts of the picture.
    size
        (rows, columns) of the picture.
    peak
        Height of the cross-correlation of their fine structure over its values elsewhere, in
        standard deviations of these (`bolme2010`); 0 where it is highest elsewhere.
    """

    matrix: Plane
    motion: Motion
    correlation: float
    error_px: float
    size: tuple[int, int]
    peak: float = math.nan

    @property
    def found(self) -> bool:
        """Whether the pictures show the same at all."""
        return self.peak > _PEAK

    def _local(self) -> tuple[Plane, Plane]:
        """Place of the middle on the truth, and the derivative there."""
        middle = np.array([(count - 1) / 2 for count in self.size])
        place, weight = _places(self.matrix, middle[:, None])
        row = self.matrix[2, :2]
        slope = (self.matrix[:2, :2] - place[:, :1] * row) / weight
        return place[:, 0], slope

    def scale_and_turn(self) -> tuple[float, float]:
        """Pixels of the truth for one of the picture, and rotation in degrees, in the middle."""
        _, slope = self._local()
        turn = math.atan2(slope[0, 1] - slope[1, 0], slope[0, 0] + slope[1, 1])
        return math.sqrt(abs(np.linalg.det(slope))), math.degrees(turn)

    def moved_px(self, other: "Registration") -> float:
        """Root mean square distance of places by another registration of the same picture."""
        grid = np.stack([each.ravel() for each in _grid(self.size, 16)])
        one, two = (_places(each.matrix, grid)[0] for each in (self, other))
        scale = self.scale_and_turn()[0]
        return float(np.sqrt(((one - two) ** 2).sum(axis=0).mean())) / scale

    def figures(self) -> dict[str, float | str | None]:
        """In values that JSON has."""
        place, _ = self._local()
        scale, turn = self.scale_and_turn()
        return {
            "register": self.motion,
            "row_in_truth": float(place[0]),
            "column_in_truth": float(place[1]),
            "scale": scale,
            "turn_deg": turn,
            "error_px": self.error_px if math.isfinite(self.error_px) else None,
            "correlation": self.correlation,
        }


def register_picture(picture: Tensor, truth: Tensor, motion: Motion) -> Registration:
    r"""Find where a picture lies on the truth; brightness and contrast may differ.

    The start is the peak of the normalised cross-correlation of coarse pictures over scales and
    rotations. From there Gauss–Newton steps on a pyramid minimise
    ``Σ (picture(x) − gain · truth(H x) − offset)²``, whose minimum is that of the enhanced
    correlation coefficient (`evangelidis2008`), by forward composition (`baker2004`).

    Parameters
    ----------
    picture, truth
        (channels, rows, columns); their channels are averaged. Of other sizes, both are taken to
        show the same view, or parts of it in the same scale, whatever correlates better.
    motion
        What is free. With "none" both are taken to show the same view.
    """
    sizes = _size(picture), _size(truth)
    scale = _scaling(*sizes)
    if motion == "none":
        one, other, bins = _landmarks(picture, truth, _LONGEST)
        bent = _binned(scale, bins)
        return Registration(scale, motion, alike(one, other, bent), math.nan, sizes[0])
    matrix = _coarse(picture, truth, motion)
    longest = _COARSEST
    while True:
        longest = min(2 * longest, _LONGEST)
        one, other, bins = _landmarks(picture, truth, longest)
        bent, error = refined(one, other, _binned(matrix, bins), FREEDOMS[motion])
        matrix = _unbinned(bent, bins)
        if max(one.shape) >= min(max(sizes[0]), _LONGEST) or longest == _LONGEST:
            correlation = alike(one, other, bent)
            peak = _peak_height(one, other, bent)
            return Registration(matrix, motion, correlation, error * bins[0], sizes[0], peak)


def resampled(truth: Tensor, registration: Registration) -> tuple[Tensor, NDArray[np.bool_]]:
    """The truth on the picture's pixels by cubic splines, and where it has any.

    Parameters
    ----------
    truth
        (channels, rows, columns); where it is finer, its pixels are averaged first.
    """
    by = max(1, int(registration.scale_and_turn()[0]))
    planes = nnf.avg_pool2d(truth[None].double(), by)[0].numpy()
    matrix = _binned(registration.matrix, (1, by))
    shift = matrix / matrix[2, 2] - np.eye(3)
    if planes.shape[-2:] == registration.size and np.abs(shift).max() < 1e-9:
        return truth, np.ones(registration.size, dtype=bool)
    place, inside = _mapped(matrix, registration.size, planes.shape[-2:], 0.0)
    moved = [ndimage.map_coordinates(each, place, order=3, mode="nearest") for each in planes]
    values = torch.from_numpy(np.stack(moved)).clamp(float(truth.min()), float(truth.max()))
    return values.to(truth.dtype), inside


def largest_window(inside: NDArray[np.bool_]) -> tuple[slice, slice]:
    """A window in which all is inside; the worst side gives way first."""
    top, bottom, left, right = 0, inside.shape[0], 0, inside.shape[1]
    while bottom > top and right > left and not inside[top:bottom, left:right].all():
        part = inside[top:bottom, left:right]
        sides = [part[0].mean(), part[-1].mean(), part[:, 0].mean(), part[:, -1].mean()]
        worst = int(np.argmin(sides))
        top, bottom = top + (worst == 0), bottom - (worst == 1)
        left, right = left + (worst == 2), right - (worst == 3)
    return slice(top, bottom), slice(left, right)


def refined(
    fixed: Plane, moving: Plane, matrix: Plane, freedoms: int, *, offset: bool = True
) -> tuple[Plane, float]:
    """Gauss–Newton steps on a homography, a gain and an offset, and the standard error of places.

    Parameters
    ----------
    fixed, moving
        Planes.
    matrix
        Start, from pixels of the first to those of the second.
    freedoms
        How many of the generators are free (`FREEDOMS`).
    offset
        Whether there is one.

    Returns
    -------
    tuple
        Matrix, and error in pixels; NaN where the overlap is too small for one.
    """
    coefficients = ndimage.spline_filter(moving, order=3)
    normal = _normalising(fixed.shape)
    grid = np.stack(_grid(fixed.shape, None)).reshape(2, -1).astype(float)
    steps = _steps(normal @ np.vstack([grid, np.ones(grid.shape[1])]), freedoms)
    back = np.linalg.inv(normal)
    error = math.nan
    for number in range(_STEPS):
        place, inside = _mapped(matrix, fixed.shape, moving.shape, _EDGE)
        if inside.sum() < 16:
            break
        warped = ndimage.map_coordinates(
            coefficients, place, order=3, mode="nearest", prefilter=False
        )
        slopes = np.stack([each.ravel() for each in np.gradient(warped)]) / normal[0, 0]
        chosen = inside.ravel()
        free = np.einsum("pix,ix->xp", steps[:, :, chosen], slopes[:, chosen])
        linear = [warped.ravel()[chosen]] + ([np.ones(int(chosen.sum()))] if offset else [])
        system = np.column_stack([free, *linear])
        solution = np.linalg.lstsq(system.T @ system, system.T @ fixed.ravel()[chosen], rcond=None)[
            0
        ]
        gain = solution[freedoms]
        if not gain > 0:
            break
        step = solution[:freedoms] / gain
        matrix = matrix @ back @ linalg.expm(np.tensordot(step, _GENERATORS[:freedoms], 1)) @ normal
        matrix = matrix / matrix[2, 2]
        if _rms(steps, step, normal) < _CONVERGED or number == _STEPS - 1:
            residual = fixed.ravel()[chosen] - system @ solution
            error = _error(system, residual, gain, steps, chosen, fixed.shape, normal)
            break
    return matrix, error


def _error(
    system: Plane,
    residual: Plane,
    gain: float,
    steps: Plane,
    chosen: NDArray[np.bool_],
    shape: tuple[int, ...],
    normal: Plane,
) -> float:
    """Standard error of places: residuals depend on each other within blocks (`liang1986`)."""
    rows, columns = (np.arange(count) * _BLOCKS // count for count in shape)
    block = np.add.outer(_BLOCKS * rows, columns).ravel()[chosen]
    scores = system * residual[:, None]
    sums = np.stack([np.bincount(block, each, _BLOCKS**2) for each in scores.T], axis=1)
    free = steps.shape[0]
    used = len(np.unique(block))
    if used <= system.shape[1]:
        return math.nan
    inverse = np.linalg.pinv(system.T @ system)
    both = inverse @ (sums.T @ sums) @ inverse * used / (used - system.shape[1])
    covariance = both[:free, :free] / gain**2
    spread = np.einsum("pix,pq,qix->x", steps, covariance, steps).mean()
    return math.sqrt(max(float(spread), 0.0)) / float(normal[0, 0])


def _steps(place: Plane, freedoms: int) -> Plane:
    """How each generator moves each place, in normalised units; (generators, 2, places)."""
    moved = _GENERATORS[:freedoms] @ place
    steps: Plane = moved[:, :2] - place[None, :2] * moved[:, 2:]
    return steps


def _rms(steps: Plane, step: Plane, normal: Plane) -> float:
    """Root mean square motion of all places, in pixels."""
    moved = np.tensordot(step, steps, 1)
    return float(np.sqrt((moved**2).sum(axis=0).mean())) / float(normal[0, 0])


def _coarse(picture: Tensor, truth: Tensor, motion: Motion) -> Plane:
    """Start: the highest normalised cross-correlation over scales, rotations and shifts."""
    one, other, bins = _landmarks(picture, truth, _COARSEST)
    ratio = _scaling(_size(picture), _size(truth))[0, 0] * bins[0] / bins[1]
    same = bins[0] / bins[1]
    scales = {same, ratio}
    if motion != "shift":
        scales = {by * each for by in scales for each in _SCALES}
    turns = [0.0] if motion == "shift" else _ANGLES
    padded = tuple(2 * max(pair) for pair in zip(one.shape, other.shape, strict=True))
    best = (-1.0, np.eye(3))
    for scale in sorted(scales):
        for turn in turns:
            linear = scale * np.array(
                [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
            )
            middles = [(np.array(each.shape) - 1) / 2 for each in (one, other)]
            matrix = np.eye(3)
            matrix[:2, :2], matrix[:2, 2] = linear, middles[1] - linear @ middles[0]
            place, inside = _mapped(matrix, one.shape, other.shape, 0.0)
            warped = ndimage.map_coordinates(other, place, order=1) * inside
            height, shift = _peak(one, warped, inside, padded)
            if height > best[0]:
                moved = np.eye(3)
                moved[:2, 2] = shift
                best = (height, matrix @ moved)
    return _unbinned(best[1], bins)


def coarse_shift(one: Plane, other: Plane, by: int, overlap: float) -> tuple[float, float]:
    """Shift of planes averaged by `by`, of all that leave so much overlap: one(x), other(x + s)."""
    small = [
        nnf.avg_pool2d(torch.from_numpy(each)[None, None], by)[0, 0].numpy()
        for each in (one, other)
    ]
    shape = small[0].shape
    padded = tuple(2 * count for count in shape)
    _, shift = _peak(small[0], small[1], np.ones(shape, dtype=bool), padded, overlap)
    return by * float(shift[0]), by * float(shift[1])


def _peak(
    one: Plane,
    other: Plane,
    inside: NDArray[np.bool_],
    padded: tuple[int, ...],
    overlap: float = _LEAST_OVERLAP,
) -> tuple[float, Plane]:
    """Highest normalised correlation of one(x) and other(x + shift), and that shift."""

    def spectrum(plane: NDArray[Any]) -> NDArray[np.complex128]:
        both: NDArray[np.complex128] = fft.rfft2(plane, padded)
        return both

    def correlated(a: NDArray[Any], b: NDArray[Any]) -> Plane:
        both: Plane = fft.irfft2(spectrum(a).conj() * spectrum(b), padded)
        return both

    everywhere = np.ones(one.shape)
    count = correlated(everywhere, inside)
    energy = correlated(one**2, inside) * correlated(everywhere, other**2)
    floor = 1e-9 * max(float(energy.max()), 1e-300)
    height = correlated(one, other) / np.sqrt(np.maximum(energy, floor))
    height[count < overlap * min(one.size, int(inside.sum()))] = -1
    at = np.unravel_index(int(height.argmax()), height.shape)
    shift = [(int(i) + n // 2) % n - n // 2 for i, n in zip(at, padded, strict=True)]
    return float(height[at]), np.array(shift, dtype=float)


def _peak_height(fixed: Plane, moving: Plane, matrix: Plane) -> float:
    """As `Registration.peak` has it."""
    place, inside = _mapped(matrix, fixed.shape, moving.shape, 0.0)
    window = largest_window(inside)
    warped = ndimage.map_coordinates(moving, place, order=1, mode="nearest")
    spectra = []
    for plane in (fixed[window], warped[window]):
        if min(plane.shape) < 3 * _SIDE:
            return 0.0
        fine = plane - ndimage.gaussian_filter(plane, _FINE * max(plane.shape))
        spectra.append(fft.fft2(fine * np.outer(*(np.hanning(count) for count in plane.shape))))
    across = fft.fftshift(fft.ifft2(spectra[0].conj() * spectra[1]).real)
    middle = np.array(across.shape) // 2
    at = np.array(np.unravel_index(int(across.argmax()), across.shape))
    if np.abs(at - middle).max() > max(2, _NEAR * max(across.shape)):
        return 0.0
    beside = np.ones(across.shape, dtype=bool)
    beside[tuple(slice(max(i - _SIDE, 0), i + _SIDE + 1) for i in at)] = False
    rest = across[beside]
    return float((across[tuple(at)] - rest.mean()) / max(float(rest.std()), 1e-300))


def _landmarks(
    picture: Tensor, truth: Tensor, longest: int
) -> tuple[Plane, Plane, tuple[int, int]]:
    """Fine structure of both, averaged over so many pixels that they have about the same scale."""
    by = max(1, math.ceil(max(_size(picture)) / longest))
    ratio = _scaling(_size(picture), _size(truth))[0, 0]
    bins = by, max(1, round(by * ratio))
    planes = []
    for each, count in zip((picture, truth), bins, strict=True):
        grey = nnf.avg_pool2d(each.double().mean(dim=0)[None, None], count)[0, 0].numpy()
        smooth = ndimage.gaussian_filter(grey, _SMOOTH * max(grey.shape), mode="nearest")
        planes.append(grey - smooth)
    return planes[0], planes[1], bins


def _size(picture: Tensor) -> tuple[int, int]:
    return picture.shape[-2], picture.shape[-1]


def _scaling(picture: tuple[int, int], truth: tuple[int, int]) -> Plane:
    """From the picture's pixels to the truth's where both show the same view."""
    by = math.sqrt(truth[0] * truth[1] / (picture[0] * picture[1]))
    matrix = np.diag([by, by, 1.0])
    if picture[0] * truth[1] != truth[0] * picture[1]:
        matrix[:2, 2] = [
            (t - 1) / 2 - by * (p - 1) / 2 for p, t in zip(picture, truth, strict=True)
        ]
    else:
        matrix[:2, 2] = (by - 1) / 2
    return matrix


def _binning(by: int) -> Plane:
    """From averaged pixels to those of the picture."""
    return np.array([[by, 0, (by - 1) / 2], [0, by, (by - 1) / 2], [0, 0, 1.0]])


def _binned(matrix: Plane, bins: tuple[int, int]) -> Plane:
    both: Plane = np.linalg.inv(_binning(bins[1])) @ matrix @ _binning(bins[0])
    return both


def _unbinned(matrix: Plane, bins: tuple[int, int]) -> Plane:
    both: Plane = _binning(bins[1]) @ matrix @ np.linalg.inv(_binning(bins[0]))
    both /= both[2, 2]
    return both


def _normalising(shape: tuple[int, ...]) -> Plane:
    """Moves the middle to 0 and half the longer side to 1, which the equations need."""
    by = 2 / max(shape)
    rows, columns = ((count - 1) / 2 for count in shape)
    return np.array([[by, 0, -by * rows], [0, by, -by * columns], [0, 0, 1.0]])


def _grid(shape: tuple[int, ...], points: int | None) -> list[NDArray[Any]]:
    """Rows and columns of all pixels, or of so many along each side."""
    lines = [np.arange(n) if points is None else np.linspace(0, n - 1, points) for n in shape]
    return list(np.meshgrid(*lines, indexing="ij"))


def _places(matrix: Plane, places: Plane) -> tuple[Plane, Plane]:
    moved = matrix @ np.vstack([places, np.ones(places.shape[1])])
    return moved[:2] / moved[2], moved[2]


def _mapped(
    matrix: Plane, shape: tuple[int, ...], other: tuple[int, ...], edge: float
) -> tuple[Plane, NDArray[np.bool_]]:
    """Where every pixel lies on the other plane, and whether that is inside of both."""
    grid = np.stack(_grid(shape, None)).astype(float)
    place = _places(matrix, grid.reshape(2, -1))[0].reshape(2, *shape)
    inside = np.ones(shape, dtype=bool)
    for at, near, far, count in zip(place, grid, shape, other, strict=True):
        inside &= (
            (at >= edge) & (at <= count - 1 - edge) & (near >= edge) & (near <= far - 1 - edge)
        )
    return place, inside


def alike(fixed: Plane, moving: Plane, matrix: Plane) -> float:
    """Correlation of both where they overlap; 0 where they do not."""
    place, inside = _mapped(matrix, fixed.shape, moving.shape, _EDGE)
    if inside.sum() < 16:
        return 0.0
    one = fixed[inside]
    other = ndimage.map_coordinates(moving, place, order=3, mode="nearest")[inside]
    one, other = one - one.mean(), other - other.mean()
    size = math.sqrt(float((one**2).sum() * (other**2).sum()))
    return float((one * other).sum()) / size if size > 0 else 0.0
