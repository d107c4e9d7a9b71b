"""A quick periodic caustic in one medium: the scenes that `docs/decisions/0002` was made with."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from nolens.kernels import fft2_, ifft2_

_LLOYD_STEPS = 3
_SAMPLES_PER_LENSLET = 30


@dataclass(frozen=True)
class LensletMask:
    """Random smooth microlenses, the model of the paper's diffuser (`uvimprint`).

    Parameters
    ----------
    radius_mm
        Radius of curvature of a lenslet.
    pitch_um
        Mean distance between lenslets.
    smoothing_um
        Standard deviation of the Gaussian that rounds the edges between them.
    index
        Refractive index of the resin.
    reduced_thickness_mm
        Σ thickness / index of the layers between mask and sensor.
    seed
        Of the lenslets' places.
    """

    radius_mm: float = 0.67
    pitch_um: float = 65.0
    smoothing_um: float = 10.0
    index: float = 1.47
    reduced_thickness_mm: float = 1.278
    seed: int = 0


def caustic_psf(
    mask: LensletMask, cells: tuple[int, int], pixel_um: float, wavelengths_nm: tuple[float, ...]
) -> Tensor:
    r"""Intensity of a plane wave behind the mask, one channel for each wavelength.

    The thin relief h turns the phase by k₀(n − 1)h; Fresnel propagation over the reduced
    thickness D multiplies the spectrum by exp(−iπλD(f_x² + f_y²)) (`goodman2005`). The mask is
    periodic, so all light that leaves one edge comes back at the other: mean intensity 1.

    Parameters
    ----------
    mask
        The surface and where it stands.
    cells
        (height, width) of the result.
    pixel_um
        Pitch of the result.
    wavelengths_nm
        In vacuum.

    Returns
    -------
    Tensor
        float32, (wavelengths, height, width).
    """
    relief_um = _relief(mask, cells, pixel_um)
    frequency = [torch.fft.fftfreq(n, pixel_um, dtype=torch.float64) for n in cells]
    squared = frequency[0][:, None] ** 2 + frequency[1][None, :] ** 2
    planes = []
    for wavelength_nm in wavelengths_nm:
        wavelength_um = wavelength_nm * 1e-3
        turn = 2 * math.pi / wavelength_um * (mask.index - 1) * relief_um
        distance_um = mask.reduced_thickness_mm * 1e3
        transfer = _unit(-math.pi * wavelength_um * distance_um * squared)
        field = ifft2_(fft2_(_unit(turn)) * transfer)
        planes.append(field.abs().square())
    return torch.stack(planes)


def _unit(phase: Tensor) -> Tensor:
    """exp(i·phase) in complex64, from a phase in float64."""
    return torch.polar(torch.ones_like(phase), phase).to(torch.complex64)


def _relief(mask: LensletMask, cells: tuple[int, int], pixel_um: float) -> Tensor:
    """Height in µm, float64: spherical caps around Lloyd-relaxed random points, smoothed."""
    generator = np.random.default_rng(mask.seed)
    size = np.array(cells) * pixel_um
    count = max(1, round(float(size.prod()) / mask.pitch_um**2))
    points = generator.uniform(size=(count, 2)) * size
    for _ in range(_LLOYD_STEPS):
        samples = generator.uniform(size=(count * _SAMPLES_PER_LENSLET, 2)) * size
        owner = cKDTree(points, boxsize=size).query(samples)[1]
        offset = samples - points[owner]
        offset -= size * np.round(offset / size)
        share = np.maximum(np.bincount(owner, minlength=count), 1)
        for axis in range(2):
            moved = np.bincount(owner, offset[:, axis], minlength=count) / share
            points[:, axis] = (points[:, axis] + moved) % size[axis]
    grid = np.stack(
        np.meshgrid(*(np.arange(n) * pixel_um for n in cells), indexing="ij"), axis=-1
    ).reshape(-1, 2)
    distance_um = cKDTree(points, boxsize=size).query(grid, workers=-1)[0].reshape(cells)
    height_um = torch.from_numpy(-(distance_um**2) / (2e3 * mask.radius_mm))
    frequency = [torch.fft.fftfreq(n, pixel_um, dtype=torch.float64) for n in cells]
    squared = frequency[0][:, None] ** 2 + frequency[1][None, :] ** 2
    blur = torch.exp(-2 * (math.pi * mask.smoothing_um) ** 2 * squared)
    smooth: Tensor = torch.fft.ifft2(torch.fft.fft2(height_um) * blur).real
    return smooth
