"""Surfaces of lenslets at random places."""

import functools
import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.kernels import fast_length, irfft2, nearest_points, rfft2
from nolens.optics.mask import Relief

_RELAXATION_STEPS = 12
_SAMPLES_PER_PITCH = 10
_BYTES_PER_POINT = 24


def random_lenslets(
    *,
    radius_um: float,
    pitch_um: float,
    smoothing_um: float,
    size_um: tuple[float, float],
    grid_um: float,
    seed: int,
) -> Relief:
    r"""Random smooth microlenses, the paper's model of its mask (`uvimprint`).

    Places are those of `relaxed_points`; a lenslet is the cap :math:`h = -d^2/2R` over the
    Voronoi cell of its point.

    Parameters
    ----------
    radius_um
        Radius of curvature.
    pitch_um
        Mean distance of neighbouring lenslets.
    smoothing_um
        Standard deviation of the Gaussian that rounds the edges between them.
    size_um
        (height, width) that the surface covers at least.
    grid_um
        Distance of the samples.
    seed
        Of the places.
    """
    samples = (
        fast_length(math.ceil(size_um[0] / grid_um) + 1, of_rows=False),
        fast_length(math.ceil(size_um[1] / grid_um) + 1, of_rows=True),
    )
    points = relaxed_points((samples[0] * grid_um, samples[1] * grid_um), pitch_um, seed)
    squared = squared_distance(points, samples, grid_um)
    return Relief(smoothed(squared.mul_(-1 / (2 * radius_um)), smoothing_um / grid_um), grid_um)


def surface_bytes(points: float) -> float:
    """Most memory that is held while a surface of so many points is laid out and smoothed."""
    return points * _BYTES_PER_POINT


def squared_distance(points: NDArray[np.float64], size: tuple[int, int], grid_um: float) -> Tensor:
    """Squared distance in um² to the nearest of some points, on a torus; float32, of shape `size`.

    Points are (count, 2), row and column in um.
    """
    return torch.from_numpy(nearest_points(points, size, grid_um)[1])


def smoothed(heights: Tensor, deviation: float) -> Tensor:
    """Heights on a torus, float32, after a Gaussian blur of a standard deviation in samples."""
    spectrum = rfft2(heights)
    for axis, count in enumerate(heights.shape):
        frequency = torch.fft.fftfreq(count, dtype=torch.float64)
        blur = torch.exp(-2 * (math.pi * deviation * frequency) ** 2).to(heights)
        spectrum *= blur[:, None] if axis == 0 else blur[: spectrum.shape[1]]
    rows, columns = heights.shape
    return irfft2(spectrum, (rows, columns))


@functools.lru_cache(maxsize=16)  # A camera is opened again by each step of a notebook.
def relaxed_points(size_um: tuple[float, float], pitch_um: float, seed: int) -> NDArray[np.float64]:
    r"""Random points that Lloyd's relaxation has spread on a torus (`lloyd1982`).

    As dense as a hexagonal arrangement of spacing `pitch_um`: :math:`2/(\sqrt3\,\text{pitch}^2)` to
    the area.

    Returns
    -------
    NDArray
        (count, 2), row and column in um, on a torus of (height, width) `size_um`. The seed is
        that of the places before relaxation.
    """
    size = np.array(size_um)
    generator = np.random.default_rng(seed)
    count = max(1, round(float(size.prod()) * 2 / (math.sqrt(3) * pitch_um**2)))
    points = generator.uniform(size=(count, 2)) * size
    step = pitch_um / _SAMPLES_PER_PITCH
    samples = (max(1, round(size[0] / step)), max(1, round(size[1] / step)))
    scale = size / samples  # Samples are square to within rounding; they are the unit of length.
    points /= scale
    rows, columns = np.indices(samples, dtype=np.float64).reshape(2, -1)
    for _ in range(_RELAXATION_STEPS):
        owner = nearest_points(points, samples, 1.0)[0].ravel()
        owned = np.maximum(np.bincount(owner, minlength=count), 1)
        for axis, place in enumerate((rows, columns)):
            offset = place - points[owner, axis]
            offset -= samples[axis] * np.round(offset / samples[axis])
            moved = np.bincount(owner, offset, minlength=count) / owned
            points[:, axis] = (points[:, axis] + moved) % samples[axis]
    spread: NDArray[np.float64] = points * scale
    spread.flags.writeable = False  # Who asks next gets the same array.
    return spread
