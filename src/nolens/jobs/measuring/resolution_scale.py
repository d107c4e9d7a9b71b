"""Angles of what a reconstructed picture shows."""

import math
from dataclasses import dataclass

import torch
from scipy import ndimage
from torch import Tensor

from nolens.evaluate import angle_of_length
from nolens.operators import Region
from nolens.twin import FieldMap, Twin


@dataclass(frozen=True)
class AngularScale:
    """How far apart the cells of a picture are in the scene.

    Parameters
    ----------
    tangent
        Of the field angle from cell to cell, in the middle of the field.
    axis
        Row and column that the optical axis falls on; None: the picture's middle.
    field
        The camera's map of the cells; None where the cells are evenly apart as they are.
    """

    tangent: float
    axis: tuple[float, float] | None = None
    field: FieldMap | None = None

    @classmethod
    def of_camera(cls, twin: Twin, region: Region) -> "AngularScale":
        """Scale of the cells of a region, by Snell's law in the camera's layers."""
        tangent = twin.cell_um / twin.stack().reduced_um
        axis = (twin.cells[0] // 2 - region.top, twin.cells[1] // 2 - region.left)
        return cls(tangent, axis, FieldMap(twin, region))

    def cells(self, angle_deg: float) -> float:
        """Cells in the middle of the field that an angle, half to each side, is long."""
        return 2 * math.tan(math.radians(angle_deg) / 2) / self.tangent

    def flat(self, picture: Tensor) -> "FlatPicture":
        """The picture as a flat screen has it: tangents of the field angle evenly apart.

        Parameters
        ----------
        picture
            (height, width).
        """
        height, width = picture.shape
        if self.field is None:
            axis = self.axis or ((height - 1) / 2, (width - 1) / 2)
            return FlatPicture(picture, self.tangent, axis)
        tangents = self.field.tangents()
        first = [math.ceil(float(each.min()) / self.tangent) for each in tangents]
        last = [math.floor(float(each.max()) / self.tangent) for each in tangents]
        rows, columns = (
            torch.arange(start, stop + 1, dtype=torch.float64) * self.tangent
            for start, stop in zip(first, last, strict=True)
        )
        reach = torch.hypot(rows[:, None].expand(-1, len(columns)), columns.expand(len(rows), -1))
        twin = self.field.twin
        away_um = twin.stack().displacement_um(reach / (1 + reach.square()).sqrt())
        share = torch.where(reach > 0, away_um / reach.clamp_min(1e-12), twin.stack().reduced_um)
        region, cells = self.field.region, twin.cells
        places = [
            rows[:, None] * share / twin.cell_um + cells[0] // 2 - region.top,
            columns * share / twin.cell_um + cells[1] // 2 - region.left,
        ]
        values = ndimage.map_coordinates(
            picture.double().cpu().numpy(), [each.numpy() for each in places], order=5,
            mode="nearest",
        )  # fmt: skip
        return FlatPicture(torch.from_numpy(values), self.tangent, (-first[0], -first[1]))


@dataclass(frozen=True)
class FlatPicture:
    """A picture on evenly spaced tangents of the field angle.

    Parameters
    ----------
    values
        (height, width).
    tangent
        From cell to cell.
    axis
        Row and column that the optical axis falls on.
    """

    values: Tensor
    tangent: float
    axis: tuple[float, float]

    def angle_deg(
        self, place: tuple[float, float], direction: tuple[float, float], cells: float
    ) -> float:
        """Angle that some cells at a row and column, in a direction, are seen under."""
        at = [(each - axis) * self.tangent for each, axis in zip(place, self.axis, strict=True)]
        return angle_of_length((at[0], at[1]), direction, cells * self.tangent)
