"""Resolution by a slanted edge in a picture."""

import math
from dataclasses import dataclass

from nolens.evaluate import EdgeResponse, edge_response
from nolens.experiments.resolution import FlatPicture


@dataclass(frozen=True)
class EdgeResolution:
    """Resolution by a slanted edge.

    Parameters
    ----------
    picture
        In which it was measured.
    response
        Spread and contrast across the edge.
    cell_deg
        Angle of a cell there, across the edge.
    """

    picture: FlatPicture
    response: EdgeResponse
    cell_deg: float

    def per_deg(self, contrast: float) -> float | None:
        """Cycles to the degree at which the contrast has fallen to a value; None: nowhere."""
        frequency = self.response.frequency_of(contrast)
        return None if frequency is None else frequency / self.cell_deg

    @classmethod
    def of(cls, picture: FlatPicture) -> "EdgeResolution":
        """Measure a picture (`edge_response`).

        Raises
        ------
        DataError
            If it shows no such edge.
        """
        response = edge_response(picture.values)
        turn = math.radians(response.direction_deg)
        across = (-math.sin(turn), math.cos(turn))
        return cls(picture, response, picture.angle_deg(response.centre, across, 1.0))
