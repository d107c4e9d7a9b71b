"""What a mask's PSF is like, measured in the twin, and that of the paper's diffuser."""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.camera import LoadedCamera, RandomLenslets
from nolens.errors import DataError
from nolens.evaluate import pattern_figures, sparsity, spectral_magnitude
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import Light, Twin, point_spread

FREQUENCIES_PER_MM = (20.0, 40.0, 80.0)
"""Spatial frequencies on the sensor at which the spectral magnitude is given."""
PAPERS_DIFFUSER = RandomLenslets(
    kind="random-lenslets",
    radius=Length("0.67", "mm"),
    pitch=Length("70", "um"),
    smoothing=Length("11", "um"),
    seed=0,
    grid=Length("1.55", "um"),
    overhang=Length("0.5", "mm"),
)
"""The paper's diffuser, as the preset describes it, around a small part of the sensor."""
_MOST_PIXELS = 576
_MIDDLE_PIXELS = 1152


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


def sensor_middle(loaded: LoadedCamera) -> LoadedCamera:
    """The camera with the middle of its sensor, and no opening: all that `central_psf` needs."""
    sensor = loaded.camera.sensor
    rows, columns = (min(_MIDDLE_PIXELS, count) for count in (sensor.rows, sensor.columns))
    small = sensor.model_copy(update={"rows": rows, "columns": columns})
    mask = loaded.camera.mask.model_copy(update={"aperture": None})
    return replace(loaded, camera=loaded.camera.model_copy(update={"sensor": small, "mask": mask}))


def central_psf(twin: Twin, light: Light) -> Tensor:
    """PSF of a far point straight ahead on the middle of the sensor, (channels, rows, columns).

    On at most 576 × 576 pixels; every channel is 1 on average for an open mask.
    """
    pixels = (min(_MOST_PIXELS, twin.shape[0]), min(_MOST_PIXELS, twin.shape[1]))
    return point_spread(twin, PointSource(), pixels, superpixel=twin.superpixel, light=light).cpu()


def mask_figures(twin: Twin, psf: Tensor) -> MaskFigures:
    """Measure a mask.

    Parameters
    ----------
    twin
        The camera with the mask.
    psf
        Its `central_psf`; the channel that is brightest on the sensor counts: green, or grey.
    """
    plane = psf[min(1, len(psf) - 1)]
    try:
        lines = pattern_figures(plane, twin.pixel_um)
        width, pitch = lines.width_um, lines.pitch_um
    except DataError:
        width = pitch = math.nan
    heights = twin.mask.relief.height_um
    return MaskFigures(
        width_um=width,
        pitch_um=pitch,
        sparsity=sparsity(plane),
        magnitude=tuple(_magnitude(plane, twin.pixel_um, each) for each in FREQUENCIES_PER_MM),
        height_um=float(heights.max() - heights.min()),
        slope=twin.mask.relief.steepest,
    )


def _magnitude(psf: Tensor, pixel_um: float, per_mm: float) -> float:
    try:
        return spectral_magnitude(psf, pixel_um, per_mm)
    except DataError:
        return math.nan


def spread_over(tile: Tensor, size: tuple[int, int]) -> Tensor:
    """A tile, repeated over (rows, columns) of samples, its middle in their middle."""
    index = [
        (torch.arange(count) - count // 2 + side // 2) % side
        for count, side in zip(size, tile.shape, strict=True)
    ]
    return tile[index[0]][:, index[1]].contiguous()
