"""Random PSFs of lensless cameras: caustics, lenslets, contours, points, shadows of masks."""

import math
from collections.abc import Callable

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor

Array = NDArray[np.float64]
Size = tuple[int, int]

_RAYS = 2
"""Rays of a caustic along a pixel."""


def random_psf(random: np.random.Generator, size: Size) -> Tensor:
    """A PSF of one of seven families, in three colours, each of sum 1.

    A caustic of a smooth surface, as diffusers make; a web of lines between bright knots, as dense
    lenslets make; waves of little contrast; images of sparse lenslets; contour lines; a few points;
    the shadow of an amplitude mask. Of each, scale, sharpness, extent and the halo of
    light that is scattered are drawn; colours differ in their magnification.

    Parameters
    ----------
    random
        All that is random comes from it.
    size
        (height, width).

    Returns
    -------
    Tensor
        float32, (3, height, width), above 0; its middle is the zero shift.
    """
    family = _FAMILIES[int(random.integers(len(_FAMILIES)))]
    light = family(random, size)
    light = light * _extent(random, size)
    light = light / max(light.sum(), 1e-12)
    scattered = random.uniform(0, 0.5) ** 2
    halo = _extent(random, size)
    light = (1 - scattered) * light + scattered * halo / halo.sum()
    blur = _scale(random, 0.6, 2.2)
    dispersion = random.normal(0, 0.002)
    colours = [
        _magnified(ndimage.gaussian_filter(light, blur * (1 + 0.1 * step)), 1 + dispersion * step)
        for step in (1, 0, -1)
    ]
    psf = np.stack(colours).clip(0, None)
    return torch.from_numpy((psf / psf.sum(axis=(1, 2), keepdims=True)).astype(np.float32))


def _scale(random: np.random.Generator, low: float, high: float) -> float:
    return math.exp(random.uniform(math.log(low), math.log(high)))


def _smooth(random: np.random.Generator, size: Size, scale: float) -> Array:
    field = ndimage.gaussian_filter(random.standard_normal(size), scale, mode="wrap")
    smooth: Array = (field - field.mean()) / max(field.std(), 1e-12)
    return smooth


def _caustic(random: np.random.Generator, size: Size) -> Array:
    """Where rays go that a smooth random surface bends."""
    feature = _scale(random, 3, 16) * _RAYS
    surface = _smooth(random, (_RAYS * size[0], _RAYS * size[1]), feature)
    bent = _scale(random, 0.5, 3) * feature**2
    rows, columns = np.mgrid[: surface.shape[0], : surface.shape[1]]
    down, aside = np.gradient(surface)
    places = [
        ((each + bent * slope) // _RAYS).astype(int)
        for each, slope in ((rows, down), (columns, aside))
    ]
    inside = (places[0] >= 0) & (places[0] < size[0]) & (places[1] >= 0) & (places[1] < size[1])
    pixels = places[0][inside] * size[1] + places[1][inside]
    light: Array = np.bincount(pixels, minlength=size[0] * size[1]).reshape(size).astype(float)
    return light


def _web(random: np.random.Generator, size: Size) -> Array:
    """Lines half-way between neighbouring knots, brighter where three of them meet."""
    pitch = _scale(random, 8, 35)
    count = max(int(size[0] * size[1] / pitch**2), 4)
    knots = random.uniform(0, 1, (count, 2)) * size
    places = np.indices(size).transpose(1, 2, 0)
    near = cKDTree(knots).query(places, k=3)[0]
    width = random.uniform(0.8, 2.5)
    lines = np.exp(-(near[..., 1] - near[..., 0]) / width)
    corners = np.exp(-(near[..., 2] - near[..., 0]) / width)
    light: Array = lines + random.uniform(0, 4) * corners + random.uniform(0, 0.3)
    return light


def _waves(random: np.random.Generator, size: Size) -> Array:
    """Light that scatters about its mean: interference of little contrast."""
    scale = _scale(random, 1, 5)
    fine = _smooth(random, size, scale) - _smooth(random, size, 2 * scale)
    light: Array = np.exp(_scale(random, 0.1, 1.5) * fine)
    return light


def _points(random: np.random.Generator, size: Size) -> Array:
    """A few points of different brightness."""
    count = int(_scale(random, 5, 200))
    light = np.zeros(size)
    rows, columns = (random.integers(0, side, count) for side in size)
    np.add.at(light, (rows, columns), random.uniform(0.2, 1, count))
    return light


def _lenslets(random: np.random.Generator, size: Size) -> Array:
    """Images of random lenslets, each of its own focus."""
    pitch = _scale(random, 5, 25)
    count = max(int(size[0] * size[1] / pitch**2), 4)
    light = np.zeros(size)
    for sharp in _scale(random, 0.5, 2) * np.array([1, 1.5, 2.5, 5]):
        layer = np.zeros(size)
        rows, columns = (random.integers(0, side, count // 4 + 1) for side in size)
        layer[rows, columns] = 1
        light += ndimage.gaussian_filter(layer, min(sharp, pitch / 2), mode="wrap")
    return light


def _contours(random: np.random.Generator, size: Size) -> Array:
    """Lines of equal height of a smooth surface."""
    scale = _scale(random, 4, 40)
    surface = _smooth(random, size, scale) * _scale(random, 0.3, 2)
    width = random.uniform(0.7, 2) / scale
    distance = np.abs(surface - np.round(surface))
    light: Array = np.exp(-0.5 * (distance / width) ** 2)
    return light


def _shadow(random: np.random.Generator, size: Size) -> Array:
    """The shadow of a mask with square holes."""
    side = max(int(_scale(random, 2, 8)), 1)
    counts = [math.ceil(each / side) for each in size]
    holes = (random.random(counts) < random.uniform(0.2, 0.5)).astype(float)
    light: Array = np.kron(holes, np.ones((side, side)))[: size[0], : size[1]]
    return light


_FAMILIES: tuple[Callable[[np.random.Generator, Size], Array], ...] = (
    _caustic,
    _caustic,
    _web,
    _web,
    _waves,
    _contours,
    _lenslets,
    _contours,
    _points,
    _shadow,
)
"""Those of dense surfaces are the most common."""


def _extent(random: np.random.Generator, size: Size) -> Array:
    """How far from the axis there is light: all over, or a round window with a soft edge."""
    if random.random() < 0.5:
        return np.ones(size)
    rows, columns = (np.arange(side) - side // 2 for side in size)
    radius = random.uniform(0.25, 0.7) * min(size)
    distance = np.hypot(rows[:, None], columns) / radius
    extent: Array = 1 / (1 + np.exp(random.uniform(4, 15) * (distance - 1)))
    return extent


def _magnified(plane: Array, factor: float, degrees: float = 0.0) -> Array:
    """A plane that is larger by a factor, and turned, about its middle pixel."""
    if factor == 1 and degrees == 0:
        return plane
    turn = math.radians(degrees)
    matrix = (
        np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]) / factor
    )
    middle = np.array([side // 2 for side in plane.shape])
    magnified: Array = ndimage.affine_transform(plane, matrix, middle - matrix @ middle, order=1)
    return magnified


def altered_psf(random: np.random.Generator, psf: Tensor) -> Tensor:
    """A PSF that is a little off: another size, turned, blurred.

    Parameters
    ----------
    random
        All that is random comes from it.
    psf
        (channels, height, width).
    """
    factor, degrees = 1 + random.normal(0, 0.002), random.normal(0, 0.1)
    blur = abs(random.normal(0, 0.4))
    planes = [
        ndimage.gaussian_filter(_magnified(plane, factor, degrees), blur)
        for plane in psf.double().numpy()
    ]
    altered = np.stack(planes).clip(0, None)
    return torch.from_numpy((altered / altered.sum(axis=(1, 2), keepdims=True)).astype(np.float32))
