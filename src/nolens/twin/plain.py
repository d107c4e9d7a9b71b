"""The plain convolution model, made ready for one scene after another."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import irfft2, irfft2_window_, rfft2_window
from nolens.twin.field import FieldMap
from nolens.twin.light import Light
from nolens.twin.measure import PatternSums, summed
from nolens.twin.model import Twin
from nolens.twin.scene import Plane, Seen, on_cells


@dataclass(frozen=True)
class PlainModel:
    """What `irradiate` does with one field point, its PSFs worked out once and kept as spectra.

    Make one with `PlainModel.of`.

    Parameters
    ----------
    twin
        The camera.
    field
        Map of the pixels that scenes fill.
    distance_um
        Of all scenes.
    """

    twin: Twin
    field: FieldMap
    distance_um: float
    _weights: Tensor
    _tangents: tuple[Tensor, Tensor]
    _sums: PatternSums

    @classmethod
    def of(
        cls,
        twin: Twin,
        field: FieldMap,
        *,
        distance_um: float,
        light: Light,
        wavelengths: int = 3,
        tick: Callable[[float], None] | None = None,
    ) -> "PlainModel":
        """Work the PSFs out.

        Parameters
        ----------
        twin, field, distance_um
            As above.
        light
            Spectrum of all scenes.
        wavelengths
            How many stand for a channel.
        tick
            Called with the fraction that is done, 0 to 1.

        Raises
        ------
        OptionError
            If the distance is beyond the model, or light passes beyond the relief.
        """
        weights = (field.solid_angle() * field.vignetting()).float()
        middle = field.region.height // 2, field.region.width // 2
        point = torch.zeros(len(twin.camera.sensor.channels), *weights.shape)
        point[:, middle[0], middle[1]] = 1 / weights[middle]
        sums = summed(
            twin,
            field,
            (Seen(point, distance_um),),
            field_points=1,
            light=light,
            wavelengths=wavelengths,
            tick=tick,
        )
        return cls(twin, field, distance_um, weights, field.tangents(), sums)

    def light(self, radiance: Tensor) -> Tensor:
        """Light of a scene on every pixel, as `Irradiated.light`.

        Parameters
        ----------
        radiance
            On the pixels of the field's support, (channels, height, width).
        """
        period = self._sums.period
        spectra = rfft2_window(radiance * self._weights, (0, 0), period)[self._channels()]
        # It is the scene's first cell that lies at the origin of the period, not its node.
        window = (*self._first(self._sums.nodes[0].cell), *self.twin.cells)
        planes = irfft2_window_(spectra.mul_(self._sums.sums[1]), window, period)
        step, (rows, columns) = self.twin.cell_pixels, self.twin.cells
        out = torch.empty(rows * step, columns * step)
        for number, plane in enumerate(planes):
            row, column = divmod(number, 2)
            torch.clamp_min(plane, 0, out=out[row::step, column::step])
        return out

    def on_cells(self, picture: Tensor) -> Tensor:
        """Lay a picture out on the pixels of the field, as large as it fits in whole.

        Parameters
        ----------
        picture
            Linear radiance, (channels, height, width), channels as the sensor has them.

        Returns
        -------
        Tensor
            (channels, height, width) of the field's support; dark beside the picture.
        """
        region = self.field.region
        size = picture.shape[-2:]
        middle = region.height // 2, region.width // 2
        half = (
            abs(float(self._tangents[0][0, middle[1]])),
            abs(float(self._tangents[1][middle[0], 0])),
        )
        longer = min(each * max(size) / side for each, side in zip(half, size, strict=True))
        plane = Plane(picture, 2 * math.degrees(math.atan(longer)), self.distance_um)
        radiance, opacity = on_cells(plane, self._tangents, region)
        return radiance * opacity

    def psf(self) -> Tensor:
        """What a point source in the middle of the field shows.

        Returns
        -------
        Tensor
            (channels, rows, columns), green as the mean of its two pixels. With an
            aperture that leaves room it has the sensor's size, without one as much more as light
            of the field needs.
        """
        sums = self._sums
        planes = irfft2(sums.sums[1], sums.period)
        if aperture_room_um(self.twin) is None:
            size = [
                count + max(edges.before) + max(edges.after)
                for count, edges in zip(self.twin.cells, sums.edges, strict=True)
            ]
            planes = planes[:, : size[0], : size[1]]
        else:
            first, cells = self._first((0, 0)), self.twin.cells
            planes = planes[:, first[0] : first[0] + cells[0], first[1] : first[1] + cells[1]]
        numbers = torch.tensor(self._channels())
        return torch.stack(
            [planes[numbers == each].mean(dim=0) for each in range(int(numbers.max()) + 1)]
        ).clamp_min_(0)

    def _first(self, cell: tuple[int, int]) -> tuple[int, int]:
        """Where the sensor begins in the period, with a cell of the scene at its origin."""
        edges = self._sums.edges
        return max(edges[0].before) + cell[0], max(edges[1].before) + cell[1]

    def _channels(self) -> list[int]:
        """Channel of each pixel of a cell."""
        mosaic = self.twin.camera.sensor.mosaic
        return [0] if mosaic == "none" else ["RGB".index(colour) for colour in mosaic]


def aperture_room_um(twin: Twin) -> tuple[float, float] | None:
    """How far the PSF behind an aperture may move before it leaves the sensor.

    Returns
    -------
    tuple
        Along the rows' and the columns' direction; None where there is no aperture, or one that
        is as large as the sensor.
    """
    opening, sensor = twin.mask.opening, twin.camera.sensor
    if opening is None:
        return None
    room = (
        (sensor.rows * twin.sensor_pitch_um - opening.height_um) / 2,
        (sensor.columns * twin.sensor_pitch_um - opening.width_um) / 2,
    )
    return room if min(room) > 0 else None
