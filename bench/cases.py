"""The problems both sides are timed on, as .npy files that both read.

Run by run.py with nolens's Python: `cases.py KIND FOLDER ...`, where KIND and the rest are one of
`synthetic HEIGHT WIDTH CHANNELS`, `random HEIGHT WIDTH CHANNELS`, `photograph HEIGHT WIDTH CHANNELS
SIDE` or `hand DATA BIN`. Each writes psf.npy and data.npy into FOLDER, float32 (channels, height,
width), every channel with unit l2 norm, and the photograph its truth.npy, whose peak is 1.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import tifffile
from scipy import fft, ndimage
from skimage import data as photographs

from objective import Array, unit_norm, window
from photographed import COLOURS, GREEN_ALONE, linear_light, mask_psf, shot

SEED = 20240229


def caustic(height: int, width: int, rng: np.random.Generator) -> Array:
    """A caustic-like PSF: where a smooth random surface's slopes send a grid of rays."""
    feature = np.sqrt(height * width) / 30
    focal = 0.4 * feature**2
    surface = ndimage.gaussian_filter(rng.standard_normal((height, width)), feature, mode="wrap")
    slopes = np.gradient(surface / surface.std())
    grid = np.mgrid[0:height, 0:width] * 1.0
    row, column = (np.clip(g + focal * s, 0, None) for g, s in zip(grid, slopes, strict=True))
    inside = (row < height) & (column < width)
    cell = row[inside].astype(int) * width + column[inside].astype(int)
    counts = np.bincount(cell, minlength=height * width).reshape(height, width)
    rows, columns = np.hanning(height + 2)[1:-1], np.hanning(width + 2)[1:-1]
    return ndimage.gaussian_filter(counts * np.outer(rows, columns), 0.8)


def sparse_scene(
    shape: tuple[int, int], sensor: tuple[int, int], rng: np.random.Generator
) -> Array:
    """Bright patches on black, within the middle of the view."""
    scene = np.zeros(shape)
    middle = scene[window(shape, (sensor[0] // 2, sensor[1] // 2))]
    for _ in range(40):
        size = rng.integers(2, max(3, sensor[0] // 12), 2)
        top, left = (rng.integers(0, n - s) for n, s in zip(middle.shape, size, strict=True))
        middle[top : top + size[0], left : left + size[1]] += rng.uniform(0.1, 1.0)
    return scene


def synthetic(height: int, width: int, channels: int) -> tuple[Array, Array]:
    """PSF and noisy measurement of a sparse scene, per channel."""
    rng = np.random.default_rng(SEED)
    domain = (fft.next_fast_len(2 * height, real=True), fft.next_fast_len(2 * width, real=True))
    psfs, frames = [], []
    for _ in range(channels):
        psf = caustic(height, width, rng)
        scene = sparse_scene(domain, (height, width), rng)
        spectrum = fft.rfft2(scene) * fft.rfft2(psf, s=domain)
        spread = np.roll(
            fft.irfft2(spectrum, s=domain), (-(height // 2), -(width // 2)), axis=(0, 1)
        )
        frame = spread[window(domain, (height, width))]
        frame = frame + 0.005 * frame.max() * rng.standard_normal(frame.shape)
        psfs.append(psf)
        frames.append(np.clip(frame, 0, None))
    return np.stack(psfs), np.stack(frames)


def hand(folder: Path, factor: int) -> tuple[Array, Array]:
    """DiffuserCam's hand: dark offset off, clipped at 0, binned by the mean."""
    psf = tifffile.imread(folder / "psf_sample.tif").astype(np.float64)
    data = tifffile.imread(folder / "rawdata_hand_sample.tif").astype(np.float64)
    dark = psf[5:15, 5:15].mean()
    psf, data = (binned(np.clip(frame - dark, 0, None), factor)[None] for frame in (psf, data))
    return psf, data


def binned(frame: Array, factor: int) -> Array:
    """Means of factor x factor cells; what is left over at the far edges is dropped."""
    height, width = (n // factor for n in frame.shape)
    cells = frame[: height * factor, : width * factor].reshape(height, factor, width, factor)
    return cells.mean(axis=(1, 3))


def random(height: int, width: int, channels: int) -> tuple[Array, Array]:
    """Numbers alone, quickly made, for what does not depend on them."""
    rng = np.random.default_rng(SEED)
    psf, data = (rng.random((channels, height, width), np.float32) for _ in range(2))
    return psf, data


def photograph(
    height: int, width: int, channels: int, side: int
) -> tuple[Array, Array, Array]:  # fmt: skip
    """PSF of the sensor's size, measurement and truth of a photograph on a part of the view."""
    truth = linear_light(photographs.astronaut(), side, channels)
    psf = mask_psf((height, width), GREEN_ALONE if channels == 1 else COLOURS)
    seen = shot(truth, psf, (height, width))
    return seen.psf.numpy(), seen.data.numpy(), seen.truth.numpy()


def main(kind: str, folder: str, *rest: str) -> None:
    target = Path(folder)
    target.mkdir(parents=True, exist_ok=True)
    if kind == "hand":
        psf, data = hand(Path(rest[0]), int(rest[1]))
    elif kind == "photograph":
        psf, data, truth = photograph(*(int(number) for number in rest))
        np.save(target / "truth.npy", truth)
    else:
        make = {"synthetic": synthetic, "random": random}[kind]
        psf, data = make(*(int(number) for number in rest))
    np.save(target / "psf.npy", unit_norm(psf).astype(np.float32))
    np.save(target / "data.npy", unit_norm(data).astype(np.float32))


if __name__ == "__main__":
    main(*sys.argv[1:])
