"""Surfaces that need no optimisation: regular lenslets and Gaussian diffusers."""

import math
from typing import Literal

import numpy as np
import torch

from nolens.optics import Relief, smoothed

Arrangement = Literal["square", "hexagonal"]


def lenslet_array(
    *,
    radius_um: float,
    pitch_um: float,
    arrangement: Arrangement,
    smoothing_um: float,
    size: tuple[int, int],
    grid_um: float,
) -> Relief:
    """Lenslets in regular places, one in the middle: caps h = −d²/2R around the nearest place.

    Parameters
    ----------
    radius_um
        Radius of curvature; negative for hollows.
    pitch_um
        Distance of neighbours.
    arrangement
        "square", or "hexagonal" with rows of lenslets along the columns' direction.
    smoothing_um
        Standard deviation of the Gaussian that rounds the edges between lenslets.
    size
        (rows, columns) of samples.
    grid_um
        Their distance.
    """
    margin = smoothing_margin(smoothing_um, grid_um)
    rows, columns = (
        (torch.arange(-margin, count + margin, dtype=torch.float64) - (count - 1) / 2) * grid_um
        for count in size
    )
    if arrangement == "square":
        lattices = [((0.0, 0.0), (pitch_um, pitch_um))]
    else:
        # A hexagonal lattice is two rectangular ones, one in the middles of the other.
        sides = (math.sqrt(3) * pitch_um, pitch_um)
        lattices = [((0.0, 0.0), sides), ((sides[0] / 2, sides[1] / 2), sides)]
    squared = torch.full((len(rows), len(columns)), math.inf)
    for start, sides in lattices:
        away = [
            (place - first) - side * torch.round((place - first) / side)
            for place, first, side in zip((rows, columns), start, sides, strict=True)
        ]
        distance = away[0].square()[:, None] + away[1].square()
        squared = torch.minimum(squared, distance.float())
    heights = smoothed(squared.mul_(-1 / (2 * radius_um)), smoothing_um / grid_um)
    inner = [slice(margin, margin + count) for count in size]
    return Relief(heights[inner[0], inner[1]].contiguous(), grid_um)


def smoothing_margin(smoothing_um: float, grid_um: float) -> int:
    """Samples beside a surface: the blur takes it for a torus, so they keep its edges apart."""
    return math.ceil(4 * smoothing_um / grid_um)


def gaussian_diffuser(
    *,
    angle_rad: float,
    feature_um: float,
    index_step: float,
    size: tuple[int, int],
    grid_um: float,
    seed: int,
) -> Relief:
    r"""Surface of Gaussian heights that scatters light in air into a Gaussian of given width.

    The heights' autocorrelation is :math:`σ^2 e^{-r^2/ℓ^2}`, so the slopes have the standard
    deviation :math:`\sqrt2 σ/ℓ` along every direction, and light is turned by Δn times the slope:
    the full width at half maximum of the scattered light is
    :math:`2\sqrt{2\ln2}\,Δn\,\sqrt2\,σ/ℓ` (`goodman2005`, of thin phase screens).

    Parameters
    ----------
    angle_rad
        Full width at half maximum of the scattered light, in air.
    feature_um
        ℓ: distance at which the heights' autocorrelation has fallen to 1/e.
    index_step
        Δn between the mask and what lies in front of it.
    size
        (rows, columns) of samples.
    grid_um
        Their distance.
    seed
        Of the heights.
    """
    deviation = angle_rad / (2 * math.sqrt(2 * math.log(2)) * abs(index_step))
    deviation *= feature_um / math.sqrt(2)
    noise = np.random.default_rng(seed).standard_normal(size)
    # White noise blurred with a Gaussian of standard deviation ℓ/2 has that autocorrelation.
    heights = smoothed(torch.from_numpy(noise).float(), feature_um / (2 * grid_um))
    # What the blur leaves of the unit variance is the sum of its squared kernel.
    left = grid_um**2 / (math.pi * feature_um**2)
    return Relief(heights * (deviation / math.sqrt(left)), grid_um)
