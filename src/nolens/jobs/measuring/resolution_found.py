"""What a measurement of the resolution comes to, in angles."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.evaluate import (
    RAYLEIGH_DIP,
    STAR_THRESHOLD,
    EdgeResponse,
    PointPair,
    ResolvedSeparation,
    StarContrast,
    edge_response,
    resolved_radii,
    resolved_separation,
    star_contrast,
)
from nolens.jobs.measuring.resolution_scale import FlatPicture


@dataclass(frozen=True)
class SeenPair:
    """One picture of two points.

    Parameters
    ----------
    separation_deg
        Angle between them.
    pair
        What the picture shows.
    picture
        (height, width).
    """

    separation_deg: float
    pair: PointPair
    picture: Tensor


@dataclass(frozen=True)
class TwoPoints:
    """Resolution by two points at several separations.

    Parameters
    ----------
    separations_deg
        Each once, the smallest first.
    dips
        Mean of the pictures of each.
    noise
        Its standard error; 0 where there is one picture.
    resolved
        The smallest angle from which on the dips are deep enough, in degrees.
    threshold
        The dip that is deep enough.
    seen
        One picture of each separation, the first that was taken.
    """

    separations_deg: tuple[float, ...]
    dips: tuple[float, ...]
    noise: tuple[float, ...]
    resolved: ResolvedSeparation
    threshold: float
    seen: tuple[SeenPair, ...]

    @property
    def resolved_deg(self) -> float | None:
        """Smallest resolved angle; None where it is beyond the separations that there are."""
        return self.resolved.value

    @classmethod
    def of(cls, seen: Sequence[SeenPair], threshold: float = RAYLEIGH_DIP) -> "TwoPoints":
        """Sort pictures by separation and find what is resolved."""
        angles = tuple(sorted({each.separation_deg for each in seen}))
        groups = [[each for each in seen if each.separation_deg == angle] for angle in angles]
        stacked = [torch.tensor([each.pair.dip for each in group]).double() for group in groups]
        dips = tuple(float(each.mean()) for each in stacked)
        noise = tuple(
            float(each.std()) / math.sqrt(len(each)) if len(each) > 1 else 0.0 for each in stacked
        )
        resolved = resolved_separation(angles, dips, noise, threshold=threshold)
        return cls(angles, dips, noise, resolved, threshold, tuple(group[0] for group in groups))


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
            picture, star, torch.tensor(pairs), tuple(resolved), tuple(off),
            tuple(each.at_limit for each in found), threshold,
        )  # fmt: skip


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
