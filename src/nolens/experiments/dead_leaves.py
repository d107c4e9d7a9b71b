"""Pictures of random leaves: scenes for data sets, from nothing but a seed."""

import math
from collections.abc import Iterator
from itertools import starmap
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

_FINER = 2
"""Samples along a pixel: edges are averaged in linear light."""
_SMALLEST, _LARGEST = 3.0, 0.5
"""Radius of a leaf where no other is given: in pixels, and over the picture's shorter side."""
_MOST = 20_000
_GAPS = 0.002
"""Part of the picture between the leaves, through which a backdrop is seen."""
_TEXTURES = (0.8, 1.2, 1.7)
"""Exponents of their amplitude over spatial frequency."""
_WHITE = 98.0

Array = NDArray[Any]


def dead_leaves(height: int, width: int, seed: int, *, smallest: float = _SMALLEST) -> Tensor:
    """A picture of leaves that hide each other, with texture and shading.

    Radii follow 1/r³, so that the picture looks alike at every size (`lee2001`). Each leaf is an
    ellipse or a box of one colour in linear light, times a texture whose amplitude falls with the
    spatial frequency, times a gradient; over all lies a smooth shading.

    Parameters
    ----------
    height, width
        Pixels.
    seed
        Of all that is random.
    smallest
        Radius of the smallest leaf in pixels.

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
    left = clear.size
    for leaf in _leaves(random, rows, columns, smallest):
        left -= _add_leaf(leaf, picture, clear, textures)
        if left <= _GAPS * clear.size:
            break
    picture[:, clear] = _colours(random, 1).T
    picture *= np.exp(0.5 * _texture(random, rows, columns, 2.5))
    white = np.percentile(picture, _WHITE)
    mean = (picture / white).clip(0, 1).reshape(3, height, _FINER, width, _FINER).mean((2, 4))
    return torch.from_numpy(mean.astype(np.float32))


class _Leaf(NamedTuple):
    """Of one leaf: lengths in samples, angles in radians."""

    row: float
    column: float
    radius: float
    angle: float
    stretch: float
    is_box: bool
    colour: Array
    texture: int
    shift: Array
    contrast: float
    slope: float
    towards: float


def _leaves(
    random: np.random.Generator, rows: int, columns: int, smallest: float
) -> Iterator[_Leaf]:
    """From the nearest to the farthest."""
    low, high = smallest * _FINER, max(_LARGEST * min(rows, columns), 2 * smallest * _FINER)
    # The inverse of the distribution function of 1/r³.
    radii = (low**-2 - random.random(_MOST) * (low**-2 - high**-2)) ** -0.5
    drawn = (
        random.uniform(0, rows, _MOST),
        random.uniform(0, columns, _MOST),
        radii,
        random.uniform(0, math.pi, _MOST),
        random.uniform(0.4, 1, _MOST),
        random.random(_MOST) < 0.3,
        _colours(random, _MOST),
        random.integers(len(_TEXTURES), size=_MOST),
        random.integers(0, [rows, columns], (_MOST, 2)),
        random.exponential(0.25, _MOST),
        random.exponential(0.3, _MOST),
        random.uniform(0, 2 * math.pi, _MOST),
    )
    return starmap(_Leaf, zip(*drawn, strict=True))


def _add_leaf(leaf: _Leaf, picture: Array, clear: NDArray[np.bool_], textures: list[Array]) -> int:
    """Paint a leaf where no nearer one is; how many samples it covers."""
    rows, columns = clear.shape
    extent = leaf.radius * (math.sqrt(2) if leaf.is_box else 1)
    top, bottom = max(0, int(leaf.row - extent)), min(rows, int(leaf.row + extent) + 2)
    left, right = max(0, int(leaf.column - extent)), min(columns, int(leaf.column + extent) + 2)
    at = clear[top:bottom, left:right].nonzero()
    if not len(at[0]):
        return 0
    down = (at[0] + (top - leaf.row)) / leaf.radius
    aside = (at[1] + (left - leaf.column)) / leaf.radius
    cosine, sine = math.cos(leaf.angle), math.sin(leaf.angle)
    along, across = cosine * aside + sine * down, (cosine * down - sine * aside) / leaf.stretch
    inside = np.maximum(abs(along), abs(across)) < 1 if leaf.is_box else along**2 + across**2 < 1
    place = at[0][inside] + top, at[1][inside] + left
    grain = textures[leaf.texture][
        (place[0] + leaf.shift[0]) % rows, (place[1] + leaf.shift[1]) % columns
    ]
    gradient = (math.cos(leaf.towards) * aside + math.sin(leaf.towards) * down)[inside]
    light = np.exp(leaf.contrast * grain + leaf.slope * gradient)
    picture[:, place[0], place[1]] = leaf.colour[:, None] * light
    clear[place] = False
    return len(place[0])


def _colours(random: np.random.Generator, count: int) -> Array:
    """In linear light: luminance over two decades, and a tint, more between blue and yellow."""
    luminance = np.exp(random.normal(-1.6, 0.9, count))
    warm, green = random.normal(0, 0.35, count), random.normal(0, 0.15, count)
    tint = np.exp(np.stack([warm - 0.5 * green, green, -warm - 0.5 * green], axis=-1))
    colours: Array = luminance[:, None] * tint / tint.mean(axis=1, keepdims=True)
    return colours


def _texture(random: np.random.Generator, rows: int, columns: int, exponent: float) -> Array:
    """Noise of mean 0 and deviation 1 whose amplitude falls with the spatial frequency."""
    down, aside = np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns)
    frequency = np.hypot(down, aside)
    frequency[0, 0] = np.inf
    spectrum = np.fft.rfft2(random.standard_normal((rows, columns))) * frequency**-exponent
    field = np.fft.irfft2(spectrum, s=(rows, columns))
    noise: Array = (field / field.std()).astype(np.float32)
    return noise
