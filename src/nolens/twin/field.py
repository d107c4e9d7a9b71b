"""Which direction of the scene belongs to which pixel of the reconstruction."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin.model import LARGEST_ANGLE_DEG, Twin


@dataclass(frozen=True)
class FieldMap:
    """Pixels of the reconstruction as directions.

    Pixel (i, j) is the one whose chief ray, through the middle of the camera, falls on sensor
    pixel (i, j); (rows // 2, columns // 2) lies on the axis.

    Parameters
    ----------
    twin
        The camera.
    region
        The pixels that the scene fills.
    """

    twin: Twin
    region: Region

    @classmethod
    def covering(cls, twin: Twin, tangents: tuple[float, float]) -> "FieldMap":
        """The map of a scene that reaches up to some tangents of the field angle.

        Parameters
        ----------
        twin
            The camera.
        tangents
            Of half the scene's height and half its width.

        Raises
        ------
        OptionError
            If a corner of the scene is beyond the model.
        """
        corner = PointSource(tangents)
        if corner.angle_deg > LARGEST_ANGLE_DEG:
            share = math.tan(math.radians(LARGEST_ANGLE_DEG)) / math.hypot(*tangents)
            full = 2 * math.degrees(math.atan(share * max(tangents)))
            raise OptionError(
                f"the scene's corners are {corner.angle_deg:.1f} deg off the axis; the model holds "
                f"to {LARGEST_ANGLE_DEG:g} deg: choose an angle of at most "
                f"{math.floor(full * 10) / 10:g}deg for this scene"
            )
        counts = []
        for tangent in tangents:
            reach = max(twin.shift_um(PointSource((0.0, tangent))))
            counts.append(2 * max(1, math.ceil(reach / twin.cell_um)))
        return cls(twin, Region.centred(counts[0], counts[1], twin.cells))

    def tangents(self) -> tuple[Tensor, Tensor]:
        """Tangents of the field angle of every pixel, two of (height, width), float64."""
        reach = self._reach()
        p = self._sines()
        tangent = p / (1 - p * p).sqrt()
        straight = self._straight_um()
        share = torch.where(reach > 0, tangent / reach.clamp_min(1e-9), 1 / straight)
        rows, columns = self._displacements()
        return rows[:, None] * share, columns * share

    def solid_angle(self) -> Tensor:
        r"""Give cos θ · dA / z² of every pixel, for a plane scene of which it shows the area dA.

        With :math:`t = \tan θ` and the displacement d, dA / z² is :math:`(t/d)(dt/dd)` times the
        pixel's area. Times `Twin.vignetting` this is the pixel's irradiance to its radiance.
        """
        reach, p = self._reach(), self._sines()
        cosine = (1 - p * p).sqrt()
        straight = self._straight_um()
        share = torch.where(reach > 0, p / cosine / reach.clamp_min(1e-9), 1 / straight)
        slope = cosine.pow(-3) / self.twin.stack().spread_um(p)
        return cosine * share * slope * self.twin.cell_um**2

    def vignetting(self) -> Tensor:
        """`Twin.vignetting` of every pixel."""
        return self.twin.vignetting(self._sines())

    def place_um(self, row: int, column: int) -> tuple[float, float]:
        """Where the chief ray of one pixel, counted from the support's first, falls."""
        cells, step = self.twin.cells, self.twin.cell_um
        return (
            (self.region.top + row - cells[0] // 2) * step,
            (self.region.left + column - cells[1] // 2) * step,
        )

    def source(self, row: int, column: int, distance_um: float) -> PointSource:
        """The point source of one pixel, counted from the support's first."""
        away = self.place_um(row, column)
        reach = math.hypot(*away)
        if reach == 0:
            return PointSource((0.0, 0.0), distance_um)
        p = float(self.twin.stack().ray(torch.tensor(reach, dtype=torch.float64)))
        tangent = p / math.sqrt(1 - p * p) / reach
        return PointSource((away[0] * tangent, away[1] * tangent), distance_um)

    def _straight_um(self) -> float:
        return self.twin.stack().reduced_um

    def _displacements(self) -> tuple[Tensor, Tensor]:
        cells, region = self.twin.cells, self.region
        rows = torch.arange(region.height, dtype=torch.float64) + (region.top - cells[0] // 2)
        columns = torch.arange(region.width, dtype=torch.float64) + (region.left - cells[1] // 2)
        return rows * self.twin.cell_um, columns * self.twin.cell_um

    def _reach(self) -> Tensor:
        rows, columns = self._displacements()
        return (rows.square()[:, None] + columns.square()).sqrt()

    def _sines(self) -> Tensor:
        return self.twin.stack().ray(self._reach())
