"""Resolution of a simulated camera: targets before it, noise on its sensor, pictures solved."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.camera import Frame, develop
from nolens.errors import DataError
from nolens.evaluate import (
    RAYLEIGH_DIP,
    STAR_SHARE,
    STAR_THRESHOLD,
    point_pair,
    siemens_star,
    slanted_edge,
)
from nolens.jobs.measuring.resolution_found import (
    EdgeResolution,
    SeenPair,
    StarResolution,
    TwoPoints,
)
from nolens.jobs.measuring.resolution_scale import AngularScale, FlatPicture
from nolens.jobs.optical_bench import OpticalBench, solved
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin import FieldMap, Plane

Tick = Callable[[float], None]

POINT_ITERATIONS = 100
TARGET_ITERATIONS = 300
TAU = 1e-5
POINTS_REGION = 48
"""Cells along the side of the square that two points are looked for in."""
EDGE_TILT_DEG = 5.0

_FIRST_CELLS = 6.0
_WIDER = 1.5
_MARGIN_CELLS = 12
_STEP_CELLS = 0.2
_PIXELS_PER_CELL = 4
_MOST_PIXELS = 1600
_SEED_STEP = 7919
EXPECTED_STEPS = 6
"""Separations that the search for the smallest resolved one usually takes."""


@dataclass(frozen=True)
class SolverSettings:
    """How pictures are taken and solved.

    Parameters
    ----------
    iterations, tau
        As `nolens reconstruct` takes them; all iterations are done.
    fill
        Share of a full pixel that the brightest one is exposed to.
    seed
        Of the noise.
    """

    iterations: int
    tau: float = TAU
    fill: float = 0.9
    seed: int = 0


@dataclass(frozen=True)
class _Camera:
    """A bench with the PSF of one distance, wide enough for a region."""

    bench: OpticalBench
    region: Region
    psf: Tensor
    settings: SolverSettings

    @classmethod
    def ready(
        cls, bench: OpticalBench, distance_um: float, region: Region, settings: SolverSettings,
        tick: Tick,
    ) -> "_Camera":  # fmt: skip
        rows, columns = bench.twin.cells
        wide = (rows + region.height, columns + region.width)
        psf = bench.psf(PointSource((0.0, 0.0), distance_um), wide, tick)
        return cls(bench, region, psf.mean(dim=0, keepdim=True), settings)

    def picture(self, frame: Frame, tick: Tick) -> Tensor:
        """The mean of the channels of what was photographed, solved as one."""
        return solved(
            develop(frame, channels="grey"), self.psf, self.region,
            iterations=self.settings.iterations, tau=self.settings.tau, tick=tick,
        )[0]  # fmt: skip


def two_point_resolution(
    bench: OpticalBench,
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
    region = Region.centred(POINTS_REGION, POINTS_REGION, bench.twin.cells)
    told = _Shares(1 + EXPECTED_STEPS * draws, tick)
    camera = _Camera.ready(bench, distance_um, region, settings, told.part)
    told.next()
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
                    (row * scale.tangent - side * half * math.sin(turn),
                     column * scale.tangent + side * half * math.cos(turn)),
                    distance_um,
                )  # fmt: skip
                light = light + bench.light_of(source)
            noise = settings.seed + _SEED_STEP * number
            picture = camera.picture(bench.exposed(light, settings.fill, noise), told.part)
            angle = math.degrees(2 * math.atan(half))
            seen.append(SeenPair(angle, point_pair(picture, cells), picture))
            told.next()
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


def siemens_resolution(
    bench: OpticalBench,
    distance_um: float,
    angle_deg: float = 20.0,
    *,
    periods: int = 36,
    threshold: float = STAR_THRESHOLD,
    settings: SolverSettings | None = None,
    tick: Tick | None = None,
) -> StarResolution:
    """Photograph a Siemens star with a simulated camera, and measure the picture.

    Parameters
    ----------
    bench
        The camera.
    distance_um
        Of the screen.
    angle_deg
        Field angle of the star from side to side.
    periods
        Bright spokes.
    threshold
        Share of the contrast of wide spokes from which on they count as resolved.
    settings
        How the picture is taken and solved.
    tick
        Called with the share that is done.

    Raises
    ------
    DataError
        If the picture shows no star.
    OptionError
        If the angle is beyond the model.
    """
    square_deg = 2 * math.degrees(math.atan(math.tan(math.radians(angle_deg) / 2) / STAR_SHARE))
    picture = _photographed(
        bench, lambda side: siemens_star(side, periods), distance_um, square_deg,
        settings or SolverSettings(TARGET_ITERATIONS), tick,
    )  # fmt: skip
    return StarResolution.of(picture, periods=periods, threshold=threshold)


def edge_resolution(
    bench: OpticalBench,
    distance_um: float,
    angle_deg: float = 10.0,
    *,
    settings: SolverSettings | None = None,
    tick: Tick | None = None,
) -> EdgeResolution:
    """Photograph an edge, 5 deg from upright, with a simulated camera, and measure the picture.

    Parameters
    ----------
    bench
        The camera.
    distance_um
        Of the screen.
    angle_deg
        Field angle that the side of the square around the edge fills.
    settings
        How the picture is taken and solved.
    tick
        Called with the share that is done.

    Raises
    ------
    DataError
        If the picture shows no edge.
    OptionError
        If the angle is beyond the model.
    """
    picture = _photographed(
        bench, lambda side: slanted_edge(side, EDGE_TILT_DEG), distance_um, angle_deg,
        settings or SolverSettings(TARGET_ITERATIONS), tick,
    )  # fmt: skip
    return EdgeResolution.of(picture)


def _photographed(
    bench: OpticalBench, target: Callable[[int], Tensor], distance_um: float, angle_deg: float,
    settings: SolverSettings, tick: Tick | None,
) -> FlatPicture:  # fmt: skip
    """A square target on a screen, reconstructed, its fall-off of light divided out."""
    tangent = math.tan(math.radians(angle_deg) / 2)
    region = FieldMap.covering(bench.twin, (tangent, tangent)).region
    scale = AngularScale.of_camera(bench.twin, region)
    told = _Shares(3, tick)
    camera = _Camera.ready(bench, distance_um, region, settings, told.part)
    told.next()
    side = min(_MOST_PIXELS, math.ceil(_PIXELS_PER_CELL * scale.cells(angle_deg)))
    radiance = target(side).float().expand(len(bench.sensor.channels), -1, -1)
    shot = bench.photograph(
        (Plane(radiance, angle_deg, distance_um),), fill=settings.fill, seed=settings.seed,
        tick=told.part,
    )  # fmt: skip
    told.next()
    return scale.flat(camera.picture(shot.frame, told.part) / shot.response)


class _Shares:
    """What share of some equal pieces of work is done."""

    def __init__(self, pieces: int, tick: Tick | None) -> None:
        self._pieces, self._done, self._tick = pieces, 0, tick

    def part(self, share: float) -> None:
        if self._tick is not None:
            self._tick(min((self._done + share) / self._pieces, 0.99))

    def next(self) -> None:
        self._done += 1
        self.part(0.0)
