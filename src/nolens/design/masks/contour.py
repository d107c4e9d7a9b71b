"""Masks whose PSF is a drawing of thin lines."""

import math
from collections.abc import Callable

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.design.masks.limits import Limits
from nolens.design.masks.optimised import descend
from nolens.design.masks.tile import Tile
from nolens.optics import squared_distance

_BAND = 0.35
_FWHM = 2 * math.sqrt(2 * math.log(2))


def random_contours(side: int, grid_um: float, spacing_um: float, seed: int) -> Tensor:
    r"""Squared distance to random closed lines, on a torus.

    The lines are where a smooth random field is zero: white noise whose spectrum is limited to a
    ring, :math:`e^{-(fL - 1)^2 / 2·0.35^2}`, so that lines lie about half of `spacing_um` L apart.

    Parameters
    ----------
    side
        Samples along the tile.
    grid_um
        Their distance.
    spacing_um
        Wavelength of the random field; lines in one direction lie half of it apart.
    seed
        Of the noise.

    Returns
    -------
    Tensor
        In um², float32, (side, side).
    """
    noise = np.random.default_rng(seed).standard_normal((side, side))
    frequency = np.fft.fftfreq(side, grid_um)
    radius = np.hypot(frequency[:, None], frequency)
    ring = np.exp(-((radius * spacing_um - 1) ** 2) / (2 * _BAND**2))
    field = np.fft.ifft2(np.fft.fft2(noise) * ring).real
    points = []
    for axis in (0, 1):
        after = np.roll(field, -1, axis)
        row, column = np.nonzero((field > 0) != (after > 0))
        fraction = field[row, column] / (field[row, column] - after[row, column])
        place = np.stack([row, column], axis=1).astype(np.float64)
        place[:, axis] += fraction
        points.append(place)
    return squared_distance(np.concatenate(points) % side * grid_um, (side, side), grid_um)


def line_target(squared_um2: Tensor, line_um: float, samples_per_pixel: int) -> Tensor:
    """Lines with a Gaussian profile of the given full width at half maximum, on pixels.

    Parameters
    ----------
    squared_um2
        Squared distance to the lines.
    line_um
        Their width.
    samples_per_pixel
        Along one of the pixels that are averaged.
    """
    target = torch.exp(-squared_um2 / (2 * (line_um / _FWHM) ** 2))
    return nnf.avg_pool2d(target[None, None], samples_per_pixel)[0, 0]


def correlation(one: Tensor, other: Tensor) -> Tensor:
    """Pearson's correlation of two PSFs."""
    a, b = one - one.mean(), other - other.mean()
    product: Tensor = (a * b).sum() / (a.norm() * b.norm())
    return product


def contour_relief(
    tile: Tile,
    squared_um2: Tensor,
    target: Tensor,
    limits: Limits,
    *,
    radius_um: float,
    iterations: int,
    stop: Callable[[int], bool] | None = None,
) -> Tensor:
    r"""Relief whose PSF is a target of lines, by near-field phase retrieval in the camera's layers.

    It begins with ridges :math:`h = -d^2/2R` over the lines, cylindrical lenses that focus on
    the sensor, and descends (`descend`) to the largest correlation of the PSF with the target.
    Unlike an alternation between the two planes (`gerchberg1972`), that keeps the surface smooth:
    it has no vortices, whose cliffs no mould fills.

    Contour PSFs made by near-field phase retrieval are those of `boominathan2020`; making them by
    edge filtering is the subject of a patent application (US 2025/0377536 A1).

    Parameters
    ----------
    tile, limits, iterations, stop
        See `descend`.
    squared_um2
        Squared distance to the lines, (side, side).
    target
        (pixels, pixels), see `line_target`.
    radius_um
        Radius of curvature R that focuses on the sensor.
    """
    start = squared_um2 * (-tile.bulge / (2 * radius_um))
    target = target.to(start.device)
    return descend(
        tile,
        start,
        limits,
        lambda psf: 1 - correlation(psf, target),
        iterations=iterations,
        stop=stop,
    )
