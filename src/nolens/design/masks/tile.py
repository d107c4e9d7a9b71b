"""Tiles that a mask repeats: their samples, their light, and the PSF behind them."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.design.masks.limits import Limits
from nolens.errors import OptionError
from nolens.kernels import fast_length
from nolens.optics import PointSource, pass_layers_
from nolens.twin import LARGEST_ANGLE_DEG, REFERENCE_NM, Light, Twin

_SCENE_DEG = 75.0
_MOST_PER_PIXEL = 8
_SPARE = 1.01
"""Rounding must not make a surface at its limit too steep for its samples."""


@dataclass(frozen=True)
class View:
    """A plane wave that a PSF is computed for.

    Parameters
    ----------
    wavelength_nm
        In vacuum.
    weight
        What it counts among all views; their sum is 1.
    tangent
        Of its field angle, (row, column), as in `PointSource`.
    """

    wavelength_nm: float
    weight: float
    tangent: tuple[float, float] = (0.0, 0.0)


class Tile:
    r"""A square piece of a mask that repeats itself, in front of a camera's layers.

    The relief h turns the phase of a plane wave by :math:`k_0(n'\cos θ' - n\cos θ)\,h`, and the
    layers multiply the spectrum by their transfer function, as in
    `nolens.optics.monochromatic_psf`. As the tile repeats itself there is no edge, and everything
    is a function of h that torch can differentiate. What the surfaces between the layers reflect
    is left out: it is the same for all masks.

    Parameters
    ----------
    twin
        The camera; its own relief does not matter.
    side
        Samples along the tile, a multiple of `samples_per_pixel`.
    grid_um
        Their distance.
    views
        The light.
    samples_per_pixel
        Along one of the squares that the PSF is averaged over.
    device
        Where to compute.
    """

    def __init__(
        self,
        twin: Twin,
        side: int,
        grid_um: float,
        views: tuple[View, ...],
        samples_per_pixel: int = 1,
        device: torch.device | str = "cpu",
    ) -> None:
        self.side = side
        self.grid_um = grid_um
        self.views = views
        self.samples_per_pixel = samples_per_pixel
        self._transfers = [_transfer(twin, side, grid_um, view, device) for view in views]
        self._turns = [_turns_per_um(twin, view) for view in views]

    @property
    def pixel_um(self) -> float:
        """Pitch of the PSF's pixels."""
        return self.grid_um * self.samples_per_pixel

    @property
    def bulge(self) -> float:
        """1 where a surface that bulges towards the scene gathers light, −1 where it spreads it."""
        return math.copysign(1.0, self._turns[0])

    def psf(self, heights_um: Tensor, view: int) -> Tensor:
        """Irradiance of one view, 1 on average.

        Parameters
        ----------
        heights_um
            (side, side), towards the scene.
        view
            Its number.

        Returns
        -------
        Tensor
            (pixels, pixels), float32.
        """
        turned = heights_um * self._turns[view]
        field = torch.complex(turned.cos(), turned.sin())
        field = torch.fft.ifft2(torch.fft.fft2(field) * self._transfers[view])
        irradiance: Tensor = field.real.square() + field.imag.square()
        if self.samples_per_pixel == 1:
            return irradiance
        return nnf.avg_pool2d(irradiance[None, None], self.samples_per_pixel)[0, 0]


@dataclass(frozen=True)
class Layout:
    """Samples of a tile that a mask repeats.

    Parameters
    ----------
    side
        Samples along the tile.
    grid_um
        Their distance.
    samples_per_pixel
        Along a pixel of the camera's reconstruction.
    """

    side: int
    grid_um: float
    samples_per_pixel: int

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
        per_superpixel = per_pixel * twin.superpixel
        # An even number of superpixels: then the middle of the tile is the edge of one.
        unit = 2 * per_superpixel
        side = math.ceil(period_um / grid_um / unit) * unit
        while fast_length(side, of_rows=False) != side:
            side += unit
        if side * grid_um < 10 * limits.feature_um:
            raise OptionError(
                f"a period of {period_um:g} µm holds less than ten features of "
                f"{limits.feature_um:g} µm: give a larger --period"
            )
        return cls(side, grid_um, per_superpixel)

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
        return Tile(twin, self.side, self.grid_um, views, self.samples_per_pixel, device)


def spread_over(tile: Tensor, size: tuple[int, int]) -> Tensor:
    """A tile, repeated over (rows, columns) of samples, its middle in their middle."""
    index = [
        (torch.arange(count) - count // 2 + side // 2) % side
        for count, side in zip(size, tile.shape, strict=True)
    ]
    return tile[index[0]][:, index[1]].contiguous()


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


def _transfer(
    twin: Twin, side: int, grid_um: float, view: View, device: torch.device | str
) -> Tensor:
    """Transfer function from the mask to the sensor, (side, side)."""
    p = twin.p_of(PointSource(view.tangent))
    size = math.hypot(*view.tangent)
    carrier = tuple(part / size * p if size > 0 else 0.0 for part in view.tangent)
    light = twin.illumination(PointSource(view.tangent), view.wavelength_nm)
    ones = torch.ones((side, side), dtype=torch.complex64, device=device)
    return pass_layers_(
        ones, grid_um, light.after, view.wavelength_nm * 1e-3, carrier=(carrier[0], carrier[1])
    )


def _turns_per_um(twin: Twin, view: View) -> float:
    """Radians that a µm of relief turns the light by."""
    squared = torch.tensor(twin.p_of(PointSource(view.tangent)) ** 2, dtype=torch.float64)
    coupling = float(twin.media(view.wavelength_nm).coupling(squared))
    return 2 * math.pi / (view.wavelength_nm * 1e-3) * coupling
