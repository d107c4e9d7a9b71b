"""On which samples, and in which light, a mask is designed."""

import math
from dataclasses import dataclass

import torch

from nolens.design.masks.limits import Limits
from nolens.design.masks.tile import Tile, View
from nolens.errors import OptionError
from nolens.kernels import fast_length
from nolens.optics import PointSource
from nolens.twin import LARGEST_ANGLE_DEG, REFERENCE_NM, Light, Twin

_SCENE_DEG = 75.0
_MOST_PER_PIXEL = 8
_SPARE = 1.01
"""Rounding must not make a surface at its limit too steep for its samples."""


@dataclass(frozen=True)
class Layout:
    """Samples of a tile that a mask repeats.

    Parameters
    ----------
    side
        Samples along the tile.
    grid_um
        Their distance.
    samples_per_cell
        Along a pixel of the camera's reconstruction.
    """

    side: int
    grid_um: float
    samples_per_cell: int

    @classmethod
    def fit(cls, twin: Twin, limits: Limits, period_um: float) -> "Layout":
        """Find samples that carry the light behind the steepest surface that the limits allow.

        Parameters
        ----------
        twin
            The camera.
        limits
            Of the process.
        period_um
            Least side of the tile.

        Raises
        ------
        OptionError
            If the limits contradict themselves or need more than 8 samples along a pixel, or the
            period is smaller than some lenslets.
        """
        step = limits.step_um or 0.0
        quarter = quarter_um(twin)
        for per_pixel in range(1, _MOST_PER_PIXEL + 1):
            grid_um = twin.sensor_pitch_um / per_pixel
            if (limits.slope * grid_um + step) * _SPARE <= quarter:
                break
        else:
            raise OptionError(
                f"a slope of {limits.slope:.3g} (and levels {step:.2g} µm apart) needs samples "
                f"finer than {grid_um:.2g} µm: give a smaller --slope, more --levels, or a smaller "
                "--height"
            )
        limits.check(grid_um, quarter)
        per_cell = per_pixel * twin.superpixel
        # An even number of cells: then the middle of the tile is the edge of a cell.
        unit = 2 * per_cell
        side = math.ceil(period_um / grid_um / unit) * unit
        while fast_length(side, of_rows=False) != side:
            side += unit
        if side * grid_um < 10 * limits.feature_um:
            raise OptionError(
                f"a period of {period_um:g} µm holds less than ten features of "
                f"{limits.feature_um:g} µm: give a larger --period"
            )
        return cls(side, grid_um, per_cell)

    def tile(self, twin: Twin, light: Light, device: torch.device | str = "cpu") -> Tile:
        """The tile in front of a camera's layers, in the mean wavelength of each of its channels.

        Parameters
        ----------
        twin
            The camera.
        light
            Spectrum of the light.
        device
            Where to compute.
        """
        channels = twin.camera.sensor.channels
        nodes = [light.wavelengths(twin.quantum_efficiency, each, 1)[0][0] for each in channels]
        views = tuple(View(wavelength_nm, 1 / len(nodes)) for wavelength_nm in nodes)
        return Tile(twin, self.side, self.grid_um, views, self.samples_per_cell, device)


def default_period_um(twin: Twin) -> float:
    """Side of a tile that shows no point of a 75° scene as another one's.

    It is as wide as that scene on the sensor; or as all of the mask that light comes through,
    where that is less.
    """
    half = math.radians(_SCENE_DEG / 2)
    scene = 2 * twin.shift_um(PointSource((0.0, math.tan(half))))[1]
    sensor = twin.camera.sensor
    opening = twin.mask.opening
    if opening is None:
        return min(scene, 2e3 * max(sensor.height_mm, sensor.width_mm))
    return min(scene, max(opening.height_um, opening.width_um))


def quarter_um(twin: Twin) -> float:
    """Height that turns the shortest light the sensor sees by a quarter wave, at the widest angle.

    The distance of samples at which a surface steps by as much is the coarsest that carries the
    light behind it (`MaskSurface.coarsest_pitch_um`).
    """
    shortest_nm = twin.quantum_efficiency.wavelength_nm[0]
    steep = math.sin(math.radians(LARGEST_ANGLE_DEG)) ** 2
    coupling = twin.media(shortest_nm).coupling(torch.tensor(steep, dtype=torch.float64))
    return shortest_nm * 1e-3 / (4 * abs(float(coupling)))


def focusing_radius_um(twin: Twin) -> float:
    """Radius of curvature that focuses far light on the sensor (`uvimprint`, eq. 5).

    R = |n' − n| D, where D is the reduced thickness of the layers behind the mask.
    """
    media = twin.media(REFERENCE_NM)
    after = twin.illumination(PointSource(), REFERENCE_NM).after
    return abs(media.below - media.above) * after.reduced_um
