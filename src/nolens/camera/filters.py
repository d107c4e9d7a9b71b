"""Filters on the pixels of a sensor: spectral ones, and polarisers."""

import math
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
import torch
from pydantic import Field, model_validator
from torch import Tensor

from nolens.camera.curves import SpectralCurve, SpectralCurveOrFile
from nolens.camera.part import ChannelName, MapFile, Number, Part, refusal
from nolens.errors import DataError
from nolens.quantities import Angle
from nolens.ranges import Between

_MOST = 256
PolarisationAngle = Annotated[Angle, Between("-360 deg", "360 deg")]
"""Of the light's oscillation, from the rows' direction (to the right) towards up."""


class Polariser(Part):
    """A linear polariser.

    Attributes
    ----------
    angle
        Of the light that it passes.
    extinction
        What it passes of that light over what it passes of light at 90 degrees to it.
    """

    angle: PolarisationAngle
    extinction: Annotated[Number, Between(1, 1e9)] = 1e9

    def passes(self, angle: Angle | None) -> float:
        r"""Fraction of light polarised at an angle that it passes; None: of light that is not.

        Malus's law: cos²Δ + sin²Δ / extinction, Δ the difference of the angles.
        """
        least = 1 / self.extinction
        if angle is None:
            return 0.5 * (1 + least)
        along = math.cos(math.radians(angle.deg - self.angle.deg)) ** 2
        return along + (1 - along) * least


_Row = Annotated[tuple[ChannelName, ...], Field(min_length=1, max_length=_MOST)]


class FilterArray(Part):
    """Filters on the pixels of a sensor, by a tile that is repeated or a map of all pixels.

    Attributes
    ----------
    tile
        Names of filters, row by row; it begins at the first pixel. Or else
    map
        an integer .tif or .npy in the camera's folder, of the sensor's size: the number of the
        filter of each pixel, from 0, in the order of `transmission` or `polarisers`.
    transmission
        Fraction of the light that each filter passes, over wavelength; a curve or its file with
        the columns ``wavelength_nm`` and the filters' names. Or else
    polarisers
        of each name its polariser.
    """

    tile: Annotated[tuple[_Row, ...] | None, Field(min_length=1, max_length=_MOST)] = None
    map: MapFile | None = None
    transmission: SpectralCurveOrFile | None = None
    polarisers: Annotated[
        dict[ChannelName, Polariser] | None, Field(min_length=1, max_length=_MOST)
    ] = None

    @model_validator(mode="after")
    def _check_one(self) -> "FilterArray":
        for names in (("tile", "map"), ("transmission", "polarisers")):
            given = [name for name in names if getattr(self, name) is not None]
            if len(given) != 1:
                raise refusal(
                    f"{' and '.join(given) or 'neither'} is given: give one of "
                    f"{' and '.join(names)}"
                )
        if self.tile is not None and len({len(row) for row in self.tile}) > 1:
            raise refusal("the rows of tile have different lengths: give as many filters in each")
        return self


@dataclass(frozen=True)
class Filters:
    """A `FilterArray` with the contents of its files.

    Attributes
    ----------
    numbers
        Of the filter of each pixel, int64, (rows, columns).
    transmission
        Of spectral filters; None of polarisers.
    polarisers
        Those in place of spectral filters.
    """

    numbers: Tensor
    transmission: SpectralCurve | None
    polarisers: tuple[Polariser, ...] = ()

    @classmethod
    def of(
        cls,
        array: FilterArray,
        size: tuple[int, int],
        transmission: SpectralCurve | None,
        numbers: Tensor | None = None,
        source: str = "the map of filters",
    ) -> "Filters":
        """Filters on a sensor of (rows, columns); `numbers` are those of a map.

        Raises
        ------
        DataError
            If the map has another size or other numbers, or the tile other names.
        """
        names = list(array.polarisers or (transmission.values if transmission else ()))
        if array.tile is not None:
            unknown = sorted({each for row in array.tile for each in row} - set(names))
            if unknown:
                raise DataError(
                    f"the tile of filters names {', '.join(unknown)}; known are {', '.join(names)}"
                )
            tile = torch.tensor([[names.index(each) for each in row] for row in array.tile])
            copies = [-(-count // side) for count, side in zip(size, tile.shape, strict=True)]
            numbers = tile.tile(copies)[: size[0], : size[1]]
        assert numbers is not None
        if tuple(numbers.shape) != size:
            raise DataError(
                f"{source} has {numbers.shape[0]}×{numbers.shape[1]} pixels and the sensor "
                f"{size[0]}×{size[1]}: give the number of a filter for each of its pixels"
            )
        low, high = int(numbers.min()), int(numbers.max())
        if low < 0 or high >= len(names):
            raise DataError(
                f"{source} has numbers from {low} to {high}, and there are {len(names)} filters: "
                f"give 0 to {len(names) - 1}"
            )
        return cls(numbers, transmission, tuple((array.polarisers or {}).values()))

    def reading(self, rows: int, columns: int) -> "Filters":
        """Those of the middle pixels."""
        top, left = ((a - b) // 2 for a, b in zip(self.numbers.shape, (rows, columns), strict=True))
        return replace(self, numbers=self.numbers[top : top + rows, left : left + columns])

    def behind(self, efficiency: SpectralCurve) -> SpectralCurve:
        """Quantum efficiency of a sensor without filters, behind each of the spectral ones."""
        assert self.transmission is not None
        grid = np.union1d(efficiency.wavelength_nm, self.transmission.wavelength_nm)
        (bare,) = (efficiency.at(channel, grid) for channel in efficiency.values)
        curve = self.transmission
        values = {name: bare * curve.at(name, grid) for name in curve.values}
        return efficiency.model_copy(update={"wavelength_nm": tuple(grid), "values": values})
