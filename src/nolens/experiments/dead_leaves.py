"""Pictures of random leaves: scenes for data sets, from nothing but a seed."""

import math

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_FINER = 2
"""Samples along a pixel: edges are averaged in linear light."""
_SMALLEST, _LARGEST = 3.0, 0.5
"""Radius of a leaf: in pixels, and over the picture's shorter side."""
_MOST = 20_000
_TEXTURES = (0.8, 1.2, 1.7)
"""Exponents of their amplitude over spatial frequency."""
_WHITE = 98.0

Array = NDArray[np.float32]


def dead_leaves(height: int, width: int, seed: int) -> Tensor:
    """A picture of leaves that hide each other, with texture and shading.

    Radii follow 1/r³, so that the picture looks alike at every size (`lee2001`). Each leaf is an
    ellipse or a box of one colour in linear light, times a texture whose amplitude falls with the
    spatial frequency, times a gradient; over all lies a smooth shading.

    Parameters
    ----------
    height, width
        Pixels.
    seed
        The picture depends on nothing else.

    Returns
    -------
    Tensor
        Linear radiance, float32, (3, height, width), 0 to 1.
    """
    random = np.random.Generator(np.random.Philox(seed))
    rows, columns = _FINER * height, _FINER * width
    textures = [_texture(random, rows, columns, exponent) for exponent in _TEXTURES]
    picture = np.zeros((3, rows, columns), np.float32)
    clear = np.ones((rows, columns), dtype=bool)
    for radius in _radii(random, min(rows, columns)):
        _add_leaf(random, picture, clear, textures, radius)
        if not clear.any():
            break
    picture[:, clear] = _colour(random)[:, None]
    picture *= np.exp(0.5 * _texture(random, rows, columns, 2.5))
    white = np.percentile(picture, _WHITE)
    mean = (picture / white).clip(0, 1).reshape(3, height, _FINER, width, _FINER).mean((2, 4))
    return torch.from_numpy(mean.astype(np.float32))


def _radii(random: np.random.Generator, side: int) -> Array:
    """Of leaves from the nearest to the farthest."""
    low, high = _SMALLEST * _FINER, max(_LARGEST * side, 2 * _SMALLEST * _FINER)
    uniform = random.random(_MOST)
    # The inverse of the distribution function of 1/r³.
    radii = (low**-2 - uniform * (low**-2 - high**-2)) ** -0.5
    result: Array = radii.astype(np.float32)
    return result


def _add_leaf(
    random: np.random.Generator,
    picture: Array,
    clear: NDArray[np.bool_],
    textures: list[Array],
    radius: float,
) -> None:
    """Paint a leaf where no nearer one is."""
    rows, columns = clear.shape
    row, column = random.uniform(0, rows), random.uniform(0, columns)
    angle, stretch = random.uniform(0, math.pi), random.uniform(0.4, 1)
    box = random.random() < 0.3
    colour, contrast = _colour(random), random.exponential(0.25)
    texture = textures[random.integers(len(textures))]
    shift = random.integers(0, [rows, columns])
    slope, towards = random.exponential(0.3), random.uniform(0, 2 * math.pi)
    extent = radius * (1.5 if box else 1.0)
    top, bottom = max(0, math.floor(row - extent)), min(rows, math.ceil(row + extent) + 1)
    left, right = max(0, math.floor(column - extent)), min(columns, math.ceil(column + extent) + 1)
    window = np.s_[top:bottom, left:right]
    if not clear[window].any():
        return
    down = ((np.arange(top, bottom) - row) / radius).astype(np.float32)[:, None]
    aside = ((np.arange(left, right) - column) / radius).astype(np.float32)
    along = math.cos(angle) * aside + math.sin(angle) * down
    across = (math.cos(angle) * down - math.sin(angle) * aside) / stretch
    inside = np.maximum(abs(along), abs(across)) < 1 if box else along**2 + across**2 < 1
    inside &= clear[window]
    if not inside.any():
        return
    at = np.nonzero(inside)
    grain = texture[(at[0] + top + shift[0]) % rows, (at[1] + left + shift[1]) % columns]
    gradient = math.cos(towards) * aside + math.sin(towards) * down
    light = np.exp(contrast * grain + slope * gradient[at])
    picture[:, at[0] + top, at[1] + left] = colour[:, None] * light
    clear[window] &= ~inside


def _colour(random: np.random.Generator) -> Array:
    """In linear light: luminance over two decades, and a tint, more between blue and yellow."""
    luminance = math.exp(random.normal(-1.6, 0.9))
    warm, green = random.normal(0, 0.35), random.normal(0, 0.15)
    tint = np.exp([warm - 0.5 * green, green, -warm - 0.5 * green])
    colour: Array = (luminance * tint / tint.mean()).astype(np.float32)
    return colour


def _texture(random: np.random.Generator, rows: int, columns: int, exponent: float) -> Array:
    """Noise of mean 0 and deviation 1 whose amplitude falls with the spatial frequency."""
    down, aside = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)
    frequency = np.hypot(down, aside)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(random.standard_normal((rows, columns))) * frequency**-exponent
    field = np.fft.irfft2(spectrum, s=(rows, columns))
    noise: Array = (field / field.std()).astype(np.float32)
    return noise
