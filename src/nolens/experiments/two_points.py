"""Two points in front of a simulated camera, or in pictures."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.evaluate import (
    RAYLEIGH_DIP,
    PointPair,
    ResolvedSeparation,
    point_pair,
    resolved_separation,
)
from nolens.experiments.resolution import AngularScale, Shares, SolverSettings, SolvingCamera
from nolens.experiments.virtual_experiment import Tick, VirtualExperiment
from nolens.operators import Region
from nolens.optics import PointSource

POINT_ITERATIONS = 100
POINTS_REGION = 48
"""Cells along the side of the square that two points are looked for in."""
_FIRST_CELLS = 6.0
_WIDER = 1.5
_MARGIN_CELLS = 12
_STEP_CELLS = 0.2
_SEED_STEP = 7919
_EXPECTED_STEPS = 6
"""Separations that the search for the smallest resolved one usually takes."""


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


def two_point_resolution(
    bench: VirtualExperiment,
    distance_um: float,
    *,
    direction_deg: float = 0.0,
    draws: int = 3,
    threshold: float = RAYLEIGH_DIP,
    settings: SolverSettings | None = None,
    tick: Tick | None = None,
) -> TwoPoints:
    """Find the smallest angle between two point sources that a simulated camera resolves.

    Each separation is photographed `draws` times, each time with other noise and with the middle
    of the points at another place within a cell, and the dips are averaged (`point_pair`). The
    points are exact: each has its own pattern. The search halves the way between the largest
    unresolved and the smallest resolved separation until they are a fifth of a cell apart.

    Parameters
    ----------
    bench
        The camera.
    distance_um
        Of the points.
    direction_deg
        Of the line through them, from the right towards up.
    draws
        Pictures of each separation.
    threshold
        Dip that counts as resolved.
    settings
        How pictures are taken and solved.
    tick
        Called with the share that is done.

    Raises
    ------
    DataError
        If even points half the region apart are not resolved.
    """
    settings = settings or SolverSettings(POINT_ITERATIONS)
    region = Region.centred(POINTS_REGION, POINTS_REGION, bench.twin.shape)
    shares = Shares(1 + _EXPECTED_STEPS * draws, tick)
    camera = SolvingCamera.ready(bench, distance_um, region, settings, shares.part)
    shares.next()
    scale = AngularScale.of_camera(bench.twin, region)
    turn = math.radians(direction_deg)
    offsets = torch.rand((draws, 2), generator=torch.Generator().manual_seed(settings.seed)) - 0.5
    seen: list[SeenPair] = []

    def is_resolved(cells: float) -> bool:
        half = cells / 2 * scale.tangent
        for number, (row, column) in enumerate(offsets.tolist()):
            light = torch.zeros(())
            for side in (-1, 1):
                source = PointSource(
                    (
                        row * scale.tangent - side * half * math.sin(turn),
                        column * scale.tangent + side * half * math.cos(turn),
                    ),
                    distance_um,
                )
                light = light + bench.light_of(source)
            noise = settings.seed + _SEED_STEP * number
            picture = camera.picture(bench.exposed(light, settings.fill, noise), shares.part)
            angle = math.degrees(2 * math.atan(half))
            seen.append(SeenPair(angle, point_pair(picture, cells), picture))
            shares.next()
        return sum(each.pair.dip for each in seen[-draws:]) / draws >= threshold

    low, high = 0.0, _FIRST_CELLS
    while not is_resolved(high):
        low, high = high, high * _WIDER
        if high > POINTS_REGION - _MARGIN_CELLS:
            raise DataError(
                f"even two points {seen[-1].separation_deg:.2g} deg apart are not resolved at "
                f"{distance_um * 1e-3:g} mm: try more iterations or another tau, or a mask that "
                "is in focus"
            )
    while high - low > _STEP_CELLS:
        middle = (low + high) / 2
        low, high = (low, middle) if is_resolved(middle) else (middle, high)
    return TwoPoints.of(seen, threshold)
