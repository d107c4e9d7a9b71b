"""Resolution by a Siemens star in a picture."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.evaluate import STAR_THRESHOLD, StarContrast, resolved_radii, star_contrast
from nolens.experiments.resolution import FlatPicture


@dataclass(frozen=True)
class StarResolution:
    """Resolution by a Siemens star.

    Parameters
    ----------
    picture
        In which it was measured.
    star
        Contrast by radius and sector.
    pairs_deg
        Angle of a bright spoke and the dark beside it, (sectors, rings).
    resolved_deg
        The smallest that is resolved, for each sector.
    plus_minus_deg
        Of each.
    at_limit
        Whether each is the finest that there is, so that finer ones may be resolved.
    threshold
        Share of the contrast of wide spokes from which on they count as resolved.
    """

    picture: FlatPicture
    star: StarContrast
    pairs_deg: Tensor
    resolved_deg: tuple[float, ...]
    plus_minus_deg: tuple[float, ...]
    at_limit: tuple[bool, ...]
    threshold: float

    @property
    def worst(self) -> int:
        """Number of the sector in which least is resolved."""
        return max(range(len(self.resolved_deg)), key=self.resolved_deg.__getitem__)

    @property
    def resolved_everywhere_deg(self) -> float:
        """Smallest pair of a bright and a dark spoke that is resolved in all directions."""
        return self.resolved_deg[self.worst]

    @property
    def diameter_deg(self) -> float:
        """Field angle of the star, from side to side."""
        middle, radius = self.star.place.centre, self.star.place.radius
        ends = [(middle[1] + side * radius - self.picture.axis[1]) for side in (-1, 1)]
        angles = [math.degrees(math.atan(end * self.picture.tangent)) for end in ends]
        return angles[1] - angles[0]

    @classmethod
    def of(
        cls, picture: FlatPicture, *, periods: int | None = None, threshold: float = STAR_THRESHOLD
    ) -> "StarResolution":
        """Measure a picture (`star_contrast`, `resolved_radii`).

        Raises
        ------
        DataError
            If it shows no such star.
        """
        star = star_contrast(picture.values, periods=periods)
        found = resolved_radii(star, threshold=threshold)

        def pair_deg(radius: float, turn: float) -> float:
            row, column = -math.sin(turn), math.cos(turn)
            place = star.place.centre[0] + radius * row, star.place.centre[1] + radius * column
            length = 2 * math.pi * radius / star.place.periods
            return picture.angle_deg(place, (column, -row), length)

        turns = torch.deg2rad(star.directions_deg).tolist()
        pairs = [[pair_deg(radius, turn) for radius in star.radii.tolist()] for turn in turns]
        resolved = [pair_deg(each.radius, turn) for each, turn in zip(found, turns, strict=True)]
        off = [
            pair_deg(each.radius + each.plus_minus, turn) - angle
            for each, turn, angle in zip(found, turns, resolved, strict=True)
        ]
        return cls(
            picture,
            star,
            torch.tensor(pairs),
            tuple(resolved),
            tuple(off),
            tuple(each.at_limit for each in found),
            threshold,
        )
