"""What a mask's PSF is like, measured in the twin."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import pattern_figures, sparsity, spectral_magnitude
from nolens.optics import PointSource
from nolens.twin import Light, Twin, point_spread

FREQUENCIES_PER_MM = (20.0, 40.0, 80.0)
"""Spatial frequencies on the sensor at which the spectral magnitude is given."""
_MOST_CELLS = 576


@dataclass(frozen=True)
class MaskFigures:
    """Figures of a mask and of its PSF.

    Parameters
    ----------
    width_um
        Full width at half maximum of the PSF's autocorrelation; NaN where it has no lines.
    pitch_um
        From the autocorrelation's first peak to its second; NaN where there is none.
    sparsity
        Fraction of the sensor without light.
    magnitude
        Spectral magnitude of one mm² of the PSF, for each of `FREQUENCIES_PER_MM`; NaN where the
        pixels are too coarse.
    height_um
        From the relief's lowest to its highest place.
    slope
        Its steepest slope.
    """

    width_um: float
    pitch_um: float
    sparsity: float
    magnitude: tuple[float, ...]
    height_um: float
    slope: float

    @property
    def line_um(self) -> float:
        """Width of a line with a Gaussian profile: that of the autocorrelation over √2."""
        return self.width_um / math.sqrt(2)


def central_psf(twin: Twin, light: Light) -> Tensor:
    """PSF of a far point straight ahead on the middle of the sensor, (channels, rows, columns).

    On at most 576 × 576 pixels; every channel is 1 on average for an open mask.
    """
    cells = (min(_MOST_CELLS, twin.shape[0]), min(_MOST_CELLS, twin.shape[1]))
    return point_spread(twin, PointSource(), cells, superpixel=twin.superpixel, light=light).cpu()


def mask_figures(twin: Twin, psf: Tensor) -> MaskFigures:
    """Measure a mask.

    Parameters
    ----------
    twin
        The camera with the mask.
    psf
        Its `central_psf`; the channel that is brightest on the sensor counts: green, or grey.
    """
    pattern = psf[min(1, len(psf) - 1)]
    try:
        lines = pattern_figures(pattern, twin.pixel_um)
        width, pitch = lines.width_um, lines.pitch_um
    except DataError:
        width = pitch = math.nan
    heights = twin.mask.relief.height_um
    return MaskFigures(
        width_um=width,
        pitch_um=pitch,
        sparsity=sparsity(pattern),
        magnitude=tuple(_magnitude(pattern, twin.pixel_um, each) for each in FREQUENCIES_PER_MM),
        height_um=float(heights.max() - heights.min()),
        slope=twin.mask.relief.steepest,
    )


def _magnitude(pattern: Tensor, cell_um: float, per_mm: float) -> float:
    try:
        return spectral_magnitude(pattern, cell_um, per_mm)
    except DataError:
        return math.nan


def spread_over(tile: Tensor, size: tuple[int, int]) -> Tensor:
    """A tile, repeated over (rows, columns) of samples, its middle in their middle."""
    index = [
        (torch.arange(count) - count // 2 + side // 2) % side
        for count, side in zip(size, tile.shape, strict=True)
    ]
    return tile[index[0]][:, index[1]].contiguous()
