"""Pictures to train on, from nothing but a seed: leaves, textures, glyphs, lines, blur, tints."""

import math
import string
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from scipy import ndimage
from torch import Tensor

from nolens.experiments.dead_leaves import dead_leaves

_FINER = 2
"""Samples of glyphs and lines along a pixel."""

Array = NDArray[Any]


def training_picture(height: int, width: int, seed: int) -> Tensor:
    """A picture with edges, textures, text, lines, shading and depth of field.

    Its ground are leaves that hide each other (`dead_leaves`), whose smallest radius differs from
    picture to picture by a factor of 20, so that some are smooth and some are busy. On it lie, each
    in some of the pictures, textures with a direction (noise of one orientation, and gratings),
    words and line drawings; a part or all of it may be out of focus. Tint, saturation and the
    curve of brightness are those of linear light. Nothing of it is a photograph: it trains priors
    whose weights have no other licence than ours (`achddou2023`).

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
    random = np.random.Generator(np.random.Philox(np.random.SeedSequence(seed, spawn_key=(1,))))
    smallest = math.exp(random.uniform(math.log(2), math.log(40)))
    picture: Array = dead_leaves(height, width, seed, smallest=smallest).numpy()
    size = height, width
    for _ in range(random.integers(0, 4)):
        texture: Array = np.exp(_patch(random, size) * _directed(random, size)).astype(np.float32)
        picture = picture * texture
    if random.random() < 0.5:
        picture = _out_of_focus(random, picture)
    if random.random() < 0.4:
        for _ in range(random.integers(1, 8)):
            picture = _painted(random, picture, _words(random, size))
    if random.random() < 0.4:
        for _ in range(random.integers(1, 10)):
            picture = _painted(random, picture, _lines(random, size))
    if random.random() < 0.2:
        picture = _out_of_focus(random, picture)
    return torch.from_numpy(_toned(random, picture))


def _toned(random: np.random.Generator, picture: Array) -> Array:
    """With another curve, saturation, tint and white, some of which is clipped."""
    picture = picture.clip(0, None) ** random.uniform(0.6, 1.5)
    grey = picture.mean(axis=0, keepdims=True)
    picture = grey + random.uniform(0.0, 1.3) * (picture - grey)
    picture = picture * np.exp(random.normal(0, 0.15, (3, 1, 1)))
    white = max(float(np.percentile(picture, random.uniform(97, 99.9))), 1e-6)
    toned: Array = (picture / white * random.uniform(0.5, 1.0)).clip(0, 1).astype(np.float32)
    return toned


def _smooth(random: np.random.Generator, size: tuple[int, int], scale: float) -> Array:
    """Noise without detail finer than a scale in pixels; mean 0, deviation 1."""
    field = ndimage.gaussian_filter(random.standard_normal(size), scale, mode="wrap")
    smooth: Array = ((field - field.mean()) / max(field.std(), 1e-9)).astype(np.float32)
    return smooth


def _patch(random: np.random.Generator, size: tuple[int, int]) -> Array:
    """1 in some places with smooth outlines, 0 in others."""
    field = _smooth(random, size, min(size) * random.uniform(0.05, 0.2))
    sharpness = math.exp(random.uniform(0, 3))
    patch: Array = (sharpness * (field - random.uniform(-0.5, 1))).clip(0, 1)
    return patch


def _directed(random: np.random.Generator, size: tuple[int, int]) -> Array:
    """Logarithm of a texture with a direction: a grating, or noise of one orientation."""
    rows, columns = np.mgrid[: size[0], : size[1]].astype(np.float32)
    angle = random.uniform(0, math.pi)
    along = math.cos(angle) * columns + math.sin(angle) * rows
    strength = random.uniform(0.05, 0.7)
    if random.random() < 0.5:
        along = along + random.uniform(0, 8) * _smooth(random, size, random.uniform(5, 30))
        wave = np.sin(along * (2 * math.pi / math.exp(random.uniform(math.log(2.5), math.log(30)))))
        if random.random() < 0.5:
            wave = np.tanh(4 * wave)
        grating: Array = (strength * wave).astype(np.float32)
        return grating
    down, aside = np.fft.fftfreq(size[0])[:, None], np.fft.rfftfreq(size[1])
    frequency = np.hypot(down, aside)
    frequency[0, 0] = np.inf
    turned = np.arctan2(down, aside) - angle
    spread = np.exp((np.cos(2 * turned) - 1) * math.exp(random.uniform(0, 4)))
    spectrum = np.fft.rfft2(random.standard_normal(size)) * spread
    field = np.fft.irfft2(spectrum * frequency ** -random.uniform(0.3, 1.5), s=size)
    noise: Array = (strength * field / max(field.std(), 1e-9)).astype(np.float32)
    return noise


def _out_of_focus(random: np.random.Generator, picture: Array) -> Array:
    """With all of it, or what lies at another distance, blurred."""
    sigma = math.exp(random.uniform(math.log(0.5), math.log(6)))
    blurred = ndimage.gaussian_filter(picture, (0, sigma, sigma), mode="reflect")
    near = _patch(random, picture.shape[1:]) if random.random() < 0.7 else np.float32(0)
    mixed: Array = near * picture + (1 - near) * blurred
    return mixed


def _painted(random: np.random.Generator, picture: Array, cover: Array) -> Array:
    """With a colour where a mask covers it."""
    colour = np.exp(random.normal(-1.2, 1.2)) * np.exp(random.normal(0, 0.4, (3, 1, 1)))
    colour = np.minimum(colour, 1.0).astype(np.float32)
    painted: Array = picture * (1 - cover) + colour * cover
    return painted


def _words(random: np.random.Generator, size: tuple[int, int]) -> Array:
    """The cover of a few lines of letters and digits, at some angle."""
    canvas = Image.new("L", (_FINER * size[1], _FINER * size[0]))
    draw = ImageDraw.Draw(canvas)
    letters = list(string.ascii_letters + string.digits + "   .,:-/&%")
    height = math.exp(random.uniform(math.log(8), math.log(min(size) / 3)))
    font = ImageFont.load_default(_FINER * height)
    count = int(random.integers(1, 6))
    text = "\n".join("".join(random.choice(letters, random.integers(2, 24))) for _ in range(count))
    place = random.uniform(-0.2, 0.8, 2) * canvas.size
    draw.multiline_text((float(place[0]), float(place[1])), text, fill=255, font=font)
    return _cover(canvas, random.normal(0, 15))


def _lines(random: np.random.Generator, size: tuple[int, int]) -> Array:
    """The cover of a curve, a polygon, parallel bars or rays from a point."""
    canvas = Image.new("L", (_FINER * size[1], _FINER * size[0]))
    draw = ImageDraw.Draw(canvas)
    width = round(_FINER * math.exp(random.uniform(math.log(0.8), math.log(6))))
    kind = random.choice(["curve", "polygon", "bars", "rays"])
    centre = random.uniform(0, 1, 2) * canvas.size
    radius = random.uniform(0.05, 0.4) * min(canvas.size)
    if kind == "rays":
        for turn in np.arange(0, 2 * math.pi, 2 * math.pi / random.integers(8, 48)):
            end = centre + radius * np.array([math.cos(turn), math.sin(turn)])
            draw.line([*centre, *end], fill=255, width=width)
    elif kind == "bars":
        for number in range(random.integers(3, 12)):
            left = float(centre[0]) + 2 * number * width
            box = [left, centre[1] - radius, left + width - 1, centre[1] + radius]
            draw.rectangle(box, fill=255)
    elif kind == "polygon":
        corners = centre + random.uniform(-radius, radius, (random.integers(3, 7), 2))
        points = [(float(x), float(y)) for x, y in corners]
        draw.polygon(points, fill=255 if random.random() < 0.3 else None, outline=255, width=width)
    else:
        steps = np.cumsum(ndimage.gaussian_filter1d(random.normal(0, 1, (200, 2)), 12, axis=0), 0)
        points = [(float(x), float(y)) for x, y in centre + radius / 8 * steps]
        draw.line(points, fill=255, width=width, joint="curve")
    return _cover(canvas, random.uniform(0, 360))


def _cover(canvas: Image.Image, angle: float) -> Array:
    """The mask of a canvas that is turned; means over its samples."""
    turned = np.asarray(canvas.rotate(angle, Image.Resampling.BILINEAR), np.float32) / 255
    height, width = (side // _FINER for side in turned.shape)
    cover: Array = turned.reshape(height, _FINER, width, _FINER).mean((1, 3))
    return cover
