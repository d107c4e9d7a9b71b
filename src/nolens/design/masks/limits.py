"""What can be made: limits of a process on height, slope, feature size and levels."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import OptionError

_FWHM = 2 * math.sqrt(2 * math.log(2))
_SLOPE_WEIGHT = 300.0
_HEIGHT_WEIGHT = 100.0


@dataclass(frozen=True)
class Limits:
    """Limits of the process that makes the master.

    Parameters
    ----------
    height_um
        From the lowest to the highest place.
    slope
        Steepest, along rows or columns.
    feature_um
        Smallest feature: the surface is free of anything finer than a Gaussian with this full
        width at half maximum.
    levels
        Number of heights that can be made, evenly from the lowest to `height_um` above it; None
        for any.
    """

    height_um: float
    slope: float
    feature_um: float
    levels: int | None = None

    @property
    def step_um(self) -> float | None:
        """Distance of the levels."""
        return None if self.levels is None else self.height_um / (self.levels - 1)

    def check(self, grid_um: float, quarter_um: float) -> None:
        """Refuse what contradicts itself.

        Parameters
        ----------
        grid_um
            Distance of the relief's samples.
        quarter_um
            Height that turns the light by a quarter of the shortest wavelength.

        Raises
        ------
        OptionError
            If a limit is no number above zero, features are finer than the samples, or the
            levels are so far apart that they scatter light.
        """
        if not (self.height_um > 0 and self.slope > 0 and self.feature_um > 0):
            raise OptionError(
                f"height {self.height_um:g} µm, slope {self.slope:g} and feature "
                f"{self.feature_um:g} µm: all three must be more than zero"
            )
        if self.feature_um < 2 * grid_um:
            raise OptionError(
                f"features of {self.feature_um:g} µm on a grid of {grid_um:g} µm: give "
                f"{2 * grid_um:g} µm or more"
            )
        if self.step_um is not None and self.step_um > quarter_um:
            needed = math.ceil(self.height_um / quarter_um) + 1
            raise OptionError(
                f"{self.levels} levels over {self.height_um:g} µm lie {self.step_um:.3g} µm apart, "
                f"more than the {quarter_um:.2g} µm that turn the light by a quarter of a "
                f"wavelength: give {needed} levels or more, or a smaller --height"
            )

    def smooth(self, raw: Tensor, grid_um: float) -> Tensor:
        """Surface without too fine features: a Gaussian blur on the tile, with its gradient."""
        deviation = self.feature_um / _FWHM / grid_um
        frequency = torch.fft.fftfreq(len(raw), device=raw.device)
        blur = torch.exp(-2 * (math.pi * deviation * frequency) ** 2)
        columns = blur[: len(raw) // 2 + 1]
        spectrum = torch.fft.rfft2(raw) * (blur[:, None] * columns)
        surface: Tensor = torch.fft.irfft2(spectrum, s=(len(raw), len(raw)))
        return surface

    def quantised(self, heights_um: Tensor) -> Tensor:
        """Heights on the nearest level, counted from the lowest of them."""
        if self.step_um is None:
            return heights_um
        lowest = heights_um.min()
        return lowest + torch.round((heights_um - lowest) / self.step_um) * self.step_um

    def excess(self, heights_um: Tensor, grid_um: float) -> Tensor:
        """Penalty on what is too steep or too high; 0 within the limits."""
        steep = torch.zeros((), device=heights_um.device)
        for axis in (0, 1):
            slope = (torch.roll(heights_um, -1, axis) - heights_um).abs() / grid_um
            steep = steep + (slope / self.slope - 1).clamp_min(0).square().mean()
        middle = (heights_um.detach().max() + heights_um.detach().min()) / 2
        high = (2 * (heights_um - middle).abs() / self.height_um - 1).clamp_min(0).square().mean()
        return _SLOPE_WEIGHT * steep + _HEIGHT_WEIGHT * high

    def enforce(self, heights_um: Tensor, grid_um: float) -> Tensor:
        """The highest surface under the given one that keeps to height and slope, quantised.

        Every sample is lowered to its neighbour's height and the slope's step until nothing
        changes, and what lies too deep is raised; that keeps the slope.
        """
        step = self.slope * grid_um
        heights = heights_um.clone()
        changed = True
        while changed:
            before = heights.clone()
            for axis in (0, 1):
                for shift in (-1, 1):
                    heights = torch.minimum(heights, torch.roll(heights, shift, axis) + step)
            changed = not torch.equal(before, heights)
        heights = heights.clamp_min(float(heights.max()) - self.height_um)
        return self.quantised(heights - heights.min())
