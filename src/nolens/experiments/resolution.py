"""Two points, Siemens stars and slanted edges in front of a simulated camera, or in pictures."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from scipy import ndimage
from torch import Tensor

from nolens.camera import Frame, develop
from nolens.errors import DataError
from nolens.evaluate import (
    RAYLEIGH_DIP,
    STAR_SHARE,
    STAR_THRESHOLD,
    EdgeResponse,
    PointPair,
    ResolvedSeparation,
    StarContrast,
    angle_of_length,
    edge_response,
    point_pair,
    resolved_radii,
    resolved_separation,
    siemens_star,
    slanted_edge,
    star_contrast,
)
from nolens.experiments.virtual_experiment import Tick, VirtualExperiment, solved
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin import FieldMap, Plane, Twin

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
            picture.double().cpu().numpy(),
            [each.numpy() for each in places],
            order=5,
            mode="nearest",
        )
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
            picture,
            star,
            torch.tensor(pairs),
            tuple(resolved),
            tuple(off),
            tuple(each.at_limit for each in found),
            threshold,
        )


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

    bench: VirtualExperiment
    region: Region
    psf: Tensor
    settings: SolverSettings

    @classmethod
    def ready(
        cls,
        bench: VirtualExperiment,
        distance_um: float,
        region: Region,
        settings: SolverSettings,
        tick: Tick,
    ) -> "_Camera":
        rows, columns = bench.twin.cells
        wide = (rows + region.height, columns + region.width)
        psf = bench.psf(PointSource((0.0, 0.0), distance_um), wide, tick)
        return cls(bench, region, psf.mean(dim=0, keepdim=True), settings)

    def picture(self, frame: Frame, tick: Tick) -> Tensor:
        """The mean of the channels of what was photographed, solved as one."""
        return solved(
            develop(frame, channels="grey"),
            self.psf,
            self.region,
            iterations=self.settings.iterations,
            tau=self.settings.tau,
            tick=tick,
        )[0]


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
    region = Region.centred(POINTS_REGION, POINTS_REGION, bench.twin.cells)
    shares = _Shares(1 + EXPECTED_STEPS * draws, tick)
    camera = _Camera.ready(bench, distance_um, region, settings, shares.part)
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


@dataclass(frozen=True)
class Screen:
    """A flat screen in front of a simulated camera, to show targets on.

    Parameters
    ----------
    bench
        The camera.
    distance_um
        Of the screen.
    settings
        How its picture is taken and solved.
    tick
        Called with the share that is done.
    """

    bench: VirtualExperiment
    distance_um: float
    settings: SolverSettings
    tick: Tick | None = None

    def star(
        self, angle_deg: float, periods: int, threshold: float = STAR_THRESHOLD
    ) -> StarResolution:
        """Photograph a Siemens star, and measure the picture.

        Parameters
        ----------
        angle_deg
            Field angle of the star from side to side.
        periods
            Bright spokes.
        threshold
            Share of the contrast of wide spokes from which on they count as resolved.

        Raises
        ------
        DataError
            If the picture shows no star.
        OptionError
            If the angle is beyond the model.
        """
        square_deg = 2 * math.degrees(math.atan(math.tan(math.radians(angle_deg) / 2) / STAR_SHARE))
        picture = self._photograph(lambda side: siemens_star(side, periods), square_deg)
        return StarResolution.of(picture, periods=periods, threshold=threshold)

    def edge(self, angle_deg: float) -> EdgeResolution:
        """Photograph an edge, 5 deg from upright, and measure the picture.

        Parameters
        ----------
        angle_deg
            Field angle that the side of the square around the edge fills.

        Raises
        ------
        DataError
            If the picture shows no edge.
        OptionError
            If the angle is beyond the model.
        """
        picture = self._photograph(lambda side: slanted_edge(side, EDGE_TILT_DEG), angle_deg)
        return EdgeResolution.of(picture)

    def _photograph(self, target: Callable[[int], Tensor], angle_deg: float) -> FlatPicture:
        """A square target, reconstructed, its fall-off of light divided out."""
        bench, settings = self.bench, self.settings
        tangent = math.tan(math.radians(angle_deg) / 2)
        region = FieldMap.covering(bench.twin, (tangent, tangent)).region
        scale = AngularScale.of_camera(bench.twin, region)
        shares = _Shares(3, self.tick)
        camera = _Camera.ready(bench, self.distance_um, region, settings, shares.part)
        shares.next()
        side = min(_MOST_PIXELS, math.ceil(_PIXELS_PER_CELL * scale.cells(angle_deg)))
        radiance = target(side).float().expand(len(bench.sensor.channels), -1, -1)
        shot = bench.photograph(
            (Plane(radiance, angle_deg, self.distance_um),),
            fill=settings.fill,
            seed=settings.seed,
            tick=shares.part,
        )
        shares.next()
        return scale.flat(camera.picture(shot.frame, shares.part) / shot.response)


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
