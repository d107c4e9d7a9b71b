"""A grid of dots in front of a camera: each one located by Snell's law, and judged."""

import cmath
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import torch
from torch import Tensor

from nolens.camera import FieldPsf
from nolens.errors import DataError, OptionError
from nolens.evaluate import Angles, Dot, Spot, angles_of, brightest_places, grade, spots_at
from nolens.experiments.virtual_experiment import VirtualExperiment, solved
from nolens.operators import PixelRectangle
from nolens.optics import PointSource, Stack
from nolens.progress import ProgressCallback, within
from nolens.solvers import Prior, Reconstructor
from nolens.twin import (
    LARGEST_ANGLE_DEG,
    FieldMap,
    Light,
    PlaneView,
    Twin,
    colours_of,
    polychromatic_psf_bytes,
    shortest_nm,
)

_FEWEST = 5
_OFF = 0.15
_PASSES = 3
_NEAR = 0.3
"""Pitches from a grid's place within which a bright place is taken for a dot of it."""
Places = list[tuple[float, float]]
"""Rows and columns, or the tangents of field angles in their directions."""
_MIDDLE_DEG = 12.0
_NEXT = 9
_NEARLY = 1.005
_MOST_DOTS = 20_000
_ITERATIONS, _FIELD_ITERATIONS = 300, 60
"""With one PSF, and with the measurement in the linear step."""
_FIELD_STEP_DEG = 12.5
_BYTES_PER_PIXEL = 8 * 12
"""Of the sensor: frame, scene and what ADMM works on."""
_MAKING_BYTES = 8
"""Per value of the PSFs over the field: each as it was made, and beside the others."""


@dataclass(frozen=True)
class GridPlacement:
    """A grid in the plane of tangents, its axes turned and its nearest dot beside the axis.

    Parameters
    ----------
    pitch_mm
        Distance of its dots, as measured.
    turned_deg
        By how much its rows are turned clockwise in the picture, -45 to 45.
    beside
        Tangents, (row, column), of the dot nearest to the axis.
    nominal
        Tangent of the nominal pitch.
    """

    pitch_mm: float
    turned_deg: float
    beside: tuple[float, float]
    nominal: float
    _step: complex

    @classmethod
    def of(
        cls, tops: Sequence[tuple[float, float]], pitch_um: float, distance_um: float
    ) -> "GridPlacement":
        r"""Fit a square grid to the dots in the middle of a picture.

        The direction is that of neighbours, by :math:`\arg Σ e^{4iφ} / 4`; then
        :math:`z = a k + b` for the whole numbers k of the dots, by least squares.

        Parameters
        ----------
        tops
            Tangents, (row, column), of bright places.
        pitch_um, distance_um
            Nominal, of the grid.

        Raises
        ------
        DataError
            If there are too few, or their pitch is another one.
        """
        nominal = pitch_um / distance_um
        if len(tops) < _FEWEST:
            raise DataError(
                f"the middle of the picture has {len(tops)} bright dots, of which a grid has "
                f"{_FEWEST} or more: check that the picture is of a grid of dots"
            )
        places = torch.tensor(
            [complex(column, row) for row, column in tops], dtype=torch.complex128
        )
        away = (places[:, None] - places).abs() + torch.eye(len(places)) * 1e9
        nearest = away.argmin(dim=1)
        gap = float(away.min(dim=1).values.median())
        to_mm = distance_um * 1e-3
        if not math.isclose(gap, nominal, rel_tol=_OFF):
            raise DataError(
                f"the dots in the middle of the picture lie {gap * to_mm:.3g} mm apart at "
                f"{to_mm:g} mm, not {pitch_um * 1e-3:g} mm: give the pitch and distance that the "
                "target has (--dot-pitch, --distance), and the camera it was taken with"
            )
        neighbours = (places[nearest] - places)[away.min(dim=1).values < 1.3 * gap]
        direction = cmath.phase(complex(((neighbours / neighbours.abs()) ** 4).sum())) / 4
        step = cmath.rect(gap, direction)
        origin = complex(places[places.abs().argmin()])
        for _ in range(_PASSES):
            exact = (places - origin) / step
            numbers = _whole(exact)
            on = (exact - numbers).abs() < _NEAR
            numbers, there = numbers[on], places[on]
            middle = numbers.mean()
            spread = numbers - middle
            step = complex((there * spread.conj()).sum() / (spread.abs() ** 2).sum())
            origin = complex(there.mean()) - step * complex(middle)
        turned = math.remainder(cmath.phase(step), math.pi / 2)
        step = cmath.rect(abs(step), turned)
        origin -= step * complex(_whole(torch.tensor(origin / step, dtype=torch.complex128)))
        return cls(
            abs(step) * to_mm, math.degrees(turned), (origin.imag, origin.real), nominal, step
        )

    def tangent(self, number: tuple[float, float]) -> tuple[float, float]:
        """Where a dot is that an upright grid on the axis has at some tangents, (row, column)."""
        upright = complex(number[1], number[0]) / self.nominal
        place = complex(self.beside[1], self.beside[0]) + self._step * upright
        return place.imag, place.real


def _whole(numbers: torch.Tensor) -> torch.Tensor:
    return torch.complex(numbers.real.round(), numbers.imag.round())


@dataclass(frozen=True)
class Rays:
    """A camera's layers over the pixels of a picture.

    Parameters
    ----------
    twin
        The camera.
    stack
        Its layers.
    axis
        Row and column of the pixel that lies on the axis.
    """

    twin: Twin
    stack: Stack
    axis: tuple[int, int]

    @classmethod
    def of(cls, twin: Twin, size: tuple[int, int]) -> "Rays":
        """For a picture of (rows, columns): all of the sensor, or an area around its middle."""
        rows, columns = (
            whole // 2 - (whole - count) // 2 for whole, count in zip(twin.shape, size, strict=True)
        )
        return cls(twin, twin.stack(), (rows, columns))

    def places(self, tangents: Places) -> Places:
        """Where the light of some directions falls."""
        at, radius, p = self._sines(tangents)
        moved = self.stack.displacement_um(p) / self.twin.pixel_um
        scale = torch.where(radius > 0, moved / radius.clamp_min(1e-12), 0.0)
        return _pairs(at * scale[:, None] + torch.tensor(self.axis, dtype=torch.float64))

    def tangents(self, places: Places) -> Places:
        """From where light falls on some places."""
        away = torch.tensor(places, dtype=torch.float64) - torch.tensor(self.axis)
        away = away * self.twin.pixel_um
        radius = away.norm(dim=1)
        p = self.stack.ray(radius)
        tangent = p / (1 - p * p).sqrt()
        return _pairs(
            away * torch.where(radius > 0, tangent / radius.clamp_min(1e-12), 0.0)[:, None]
        )

    def spacings(self, tangents: Places, step: float) -> list[float]:
        """Pixels between dots whose tangents are a step apart, in the direction that is nearer."""
        _, radius, p = self._sines(tangents)
        along = self.stack.spread_um(p) * (1 - p * p).pow(1.5)
        across = torch.where(
            radius > 0,
            self.stack.displacement_um(p) / radius.clamp_min(1e-12),
            self.stack.reduced_um,
        )
        spacings: list[float] = (
            torch.minimum(along, across) * (step / self.twin.pixel_um)
        ).tolist()
        return spacings

    def light(self, tangents: Places) -> list[float]:
        """Light of dots on a plane, 1 on the axis: cos θ for its slant, and `Twin.vignetting`."""
        _, _, p = self._sines(tangents)
        light: list[float] = ((1 - p * p).sqrt() * self.twin.vignetting(p)).tolist()
        return light

    def _sines(self, tangents: Places) -> tuple[Tensor, Tensor, Tensor]:
        at = torch.tensor(tangents, dtype=torch.float64).reshape(-1, 2)
        radius = at.norm(dim=1)
        return at, radius, radius / (1 + radius * radius).sqrt()


def angle_between_deg(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Angle between the rays of two tangents."""
    across = (
        one[0] - other[0],
        one[1] - other[1],
        one[0] * other[1] - one[1] * other[0],
    )
    return math.degrees(math.atan2(math.hypot(*across), 1 + one[0] * other[0] + one[1] * other[1]))


def _pairs(values: Tensor) -> Places:
    return [(row, column) for row, column in values.tolist()]


@dataclass(frozen=True)
class DotGrid:
    """A grid of dots in a picture.

    Parameters
    ----------
    dots
        All that should be there, by angle.
    angles
        Up to where they are good, and from where on lost.
    placement
        Where the grid is, and how it is turned.
    pixel_deg
        What a pixel in the middle of the picture sees.
    picture
        (rows, columns).
    simulated_psfs
        PSFs along each side of the field that were blended; None of a picture that was not
        simulated.
    field_error
        How far off the blend is (`Irradiated.relative_error`).
    warnings
        About that, in sentences.
    """

    dots: list[Dot]
    angles: Angles
    placement: GridPlacement
    pixel_deg: float
    picture: Tensor
    simulated_psfs: int | None = None
    field_error: dict[str, float] | None = None
    warnings: tuple[str, ...] = ()

    @property
    def figures(self) -> dict[str, Any]:
        """Angles, placement and every dot, in values that JSON has."""
        blend = {"simulated_psfs": self.simulated_psfs, "field_error": self.field_error}
        return {
            **asdict(self.angles),
            **({} if self.simulated_psfs is None else blend),
            "measured_pitch_mm": self.placement.pitch_mm,
            "turned_deg": self.placement.turned_deg,
            "pixel_deg": self.pixel_deg,
            "dots": [asdict(dot) for dot in self.dots],
        }


def locate_grid(
    picture: Tensor,
    twin: Twin,
    *,
    pitch_um: float,
    distance_um: float,
    extent_deg: float = LARGEST_ANGLE_DEG,
) -> DotGrid:
    """Find the dots of a grid in a picture, and judge each.

    Where it should be follows from the camera's layers by Snell's law, once it is known how the
    grid stands before the camera (`GridPlacement`, from the dots in the middle).

    Parameters
    ----------
    picture
        (rows, columns), linear, around the pixel on the camera's axis.
    twin
        The camera.
    pitch_um, distance_um
        Of the grid; the distance from the camera.
    extent_deg
        Half angle up to which dots are looked for.

    Raises
    ------
    DataError
        If there are no dots in the middle of the picture, or they are not so far apart.
    OptionError
        If dots so far apart are less than two pixels apart in the picture, or beyond number.
    """
    step = pitch_um / distance_um
    pixel_tangent = twin.pixel_um / twin.stack().reduced_um
    if step < 2 * pixel_tangent:
        raise OptionError(
            f"dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm are "
            f"{step / pixel_tangent:.2g} pixels apart in the picture: to be resolved they need 2 "
            f"or more, {2 * pixel_tangent * distance_um * 1e-3:.2g} mm"
        )
    at = grid_tangents(pitch_um, distance_um, extent_deg)
    rays = Rays.of(twin, (picture.shape[0], picture.shape[1]))
    placement = GridPlacement.of(
        rays.tangents(_middle_tops(picture, rays, step)), pitch_um, distance_um
    )
    # Up to the last ring, though the placement is not exact.
    limit = math.tan(math.radians(extent_deg)) * _NEARLY
    tangents = [each for each in map(placement.tangent, at) if math.hypot(*each) <= limit]
    tangents.sort(key=lambda each: math.hypot(*each))
    inside = [_inside(place, picture) for place in rays.places(tangents)]
    tangents = [each for each, there in zip(tangents, inside, strict=True) if there]
    spots = spots_at(picture, rays.places(tangents), rays.spacings(tangents, step))
    dots = _judged(rays, tangents, spots)
    return DotGrid(
        dots, angles_of(dots), placement, math.degrees(math.atan(pixel_tangent)), picture
    )


def grid_tangents(
    pitch_um: float, distance_um: float, extent_deg: float
) -> list[tuple[float, float]]:
    """Tangents, (row, column), of all dots of a grid around the axis up to a half angle.

    Raises
    ------
    OptionError
        If there are fewer than nine, or more than 20 000.
    """
    step, limit = pitch_um / distance_um, math.tan(math.radians(extent_deg))
    most = int(limit / step + 1e-9)
    if (2 * most + 1) ** 2 > _MOST_DOTS:
        raise OptionError(
            f"dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm are more than "
            f"{_MOST_DOTS} up to {extent_deg:g} deg: choose a larger pitch or a smaller extent"
        )
    if most < 1:
        raise OptionError(
            f"of dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm, up to "
            f"{extent_deg:g} deg there is only one: choose a smaller pitch or a larger extent"
        )
    return [
        (i * step, j * step)
        for i in range(-most, most + 1)
        for j in range(-most, most + 1)
        if math.hypot(i, j) * step <= limit * (1 + 1e-9)
    ]


def _judged(rays: Rays, tangents: Places, spots: list[Spot | None]) -> list[Dot]:
    """Every dot beside those in the middle: within 12°, or the nine next to the axis."""
    angles = [PointSource(each).angle_deg for each in tangents]
    expected = rays.light(tangents)
    middle = [
        (spot, light)
        for number, (spot, light) in enumerate(zip(spots, expected, strict=True))
        if spot is not None and (angles[number] <= _MIDDLE_DEG or number < _NEXT)
    ]
    if len(middle) < _FEWEST:
        raise DataError(
            f"only {len(middle)} dots of the grid are found in the middle of the picture: check "
            "--dot-pitch, --distance and --camera, and that the picture is of a grid of dots"
        )
    width = _median([spot.width for spot, _ in middle])
    power = _median([spot.light / light for spot, light in middle])
    places = rays.places(tangents)
    there = rays.tangents(
        [place if spot is None else spot.place for place, spot in zip(places, spots, strict=True)]
    )
    dots = []
    for number, (place, spot) in enumerate(zip(places, spots, strict=True)):
        angle, light = angles[number], expected[number]
        if spot is None:
            dots.append(Dot(angle, place, None, None, None, None, None, None, light, "lost"))
            continue
        off = math.dist(spot.place, place)
        fraction = spot.light / power
        dots.append(
            Dot(
                angle_deg=angle,
                expected=place,
                position=spot.place,
                error_pixels=off,
                error_deg=angle_between_deg(tangents[number], there[number]),
                width_pixels=spot.width,
                width=spot.width / width,
                light=fraction,
                expected_light=light,
                grade=grade(
                    width=spot.width / width,
                    error=off / width,
                    light=fraction / light if light > 0 else 0.0,
                ),
            )
        )
    return dots


def _inside(place: tuple[float, float], picture: Tensor) -> bool:
    return all(0 <= at <= count - 1 for at, count in zip(place, picture.shape, strict=True))


def _middle_tops(picture: Tensor, rays: Rays, step: float) -> Places:
    """Bright places within a few pitches of the axis, or within 12° where that is more."""
    tangent = max(math.tan(math.radians(_MIDDLE_DEG)), 2.6 * step)
    (_, column), *_ = rays.places([(0.0, tangent)])
    extent = math.ceil(column) - rays.axis[1]
    top, left = (max(0, at - extent) for at in rays.axis)
    part = picture[top : rays.axis[0] + extent + 1, left : rays.axis[1] + extent + 1]
    if part.numel() == 0 or not float(part.max()) > float(part.median()):
        raise DataError("the middle of the picture is empty: it shows no grid of dots")
    return [(top + row, left + column) for row, column in brightest_places(part)]


def _median(values: list[float]) -> float:
    return float(torch.tensor(values, dtype=torch.float64).median())


def dot_grid(
    experiment: VirtualExperiment,
    *,
    pitch_um: float,
    distance_um: float,
    extent_deg: float = LARGEST_ANGLE_DEG,
    psf_points: int = 1,
    prior: Prior = Prior.AUTO,
    iterations: int | None = None,
    seed: int = 0,
    progress: ProgressCallback | None = None,
) -> DotGrid:
    """Show a camera a grid of dots, reconstruct what it measures, and find them in the picture.

    The PSF of the reconstruction is the central one, or those of several field points, known as
    far as light from the grid passes; light can come from the grid's support alone. Each dot is
    smaller than a pixel.

    Parameters
    ----------
    experiment
        The camera; between its field points PSFs are blended.
    pitch_um, distance_um
        Of the grid.
    extent_deg
        Half angle up to which there are dots.
    psf_points
        PSFs along each side of the field that the reconstruction has; odd.
    prior
        What it assumes of the scene.
    iterations
        Of the reconstruction; None makes 300, with several PSFs 60 (decision 18).
    seed
        Of the noise.
    progress
        Called with the fraction that is done.

    Raises
    ------
    OptionError
        If there are too few dots up to that angle, or the angle is beyond the model.
    DataError
        If the picture shows no such grid.
    """
    twin = experiment.twin
    at = grid_tangents(pitch_um, distance_um, extent_deg)
    twin.check_source(PointSource((0.0, math.tan(math.radians(extent_deg))), distance_um))
    field = _map_of(twin, extent_deg, pitch_um / distance_um)
    scene = _radiance(field, at)

    channels = len(experiment.sensor.channels)
    view = PlaneView(scene.expand(channels, -1, -1).contiguous(), distance_um)
    first, rest = within(progress, 0.0, 0.6), within(progress, 0.6, 0.4)
    shot = experiment.measure_views(field, (view,), seed=seed, progress=first)
    rows, columns = twin.shape
    wide = rows + field.support.height, columns + field.support.width
    psf = experiment.psf(PointSource((0.0, 0.0), distance_um), wide)
    several = None
    if psf_points > 1:
        several = experiment.field_psf(field.support, psf_points, distance_um)
    picture = solved(
        shot.frame,
        psf,
        field.support,
        iterations=iterations or (_ITERATIONS if several is None else _FIELD_ITERATIONS),
        prior=prior,
        field_psf=several,
        progress=rest,
    )
    grid = locate_grid(
        picture.cpu().mean(dim=0),
        twin,
        pitch_um=pitch_um,
        distance_um=distance_um,
        extent_deg=extent_deg,
    )
    return replace(
        grid,
        simulated_psfs=shot.field_points,
        field_error=shot.field_error,
        warnings=tuple(shot.field_warnings("--simulated-psfs")),
    )


def dot_grid_bytes(
    twin: Twin,
    *,
    pitch_um: float,
    distance_um: float,
    extent_deg: float,
    simulated_psfs: int,
    psf_points: int,
) -> float:
    """Bytes that `dot_grid` holds at once, beside the relief.

    The simulation's PSFs have one sample to the pixel, and are wider than the sensor by a part of
    the support; those that the picture is reconstructed with are kept, all of them.

    Parameters
    ----------
    twin, pitch_um, distance_um, extent_deg, psf_points
        As `dot_grid` takes them; a preview of the camera will do.
    simulated_psfs
        Along each side of the field.
    """
    sensor = twin.camera.sensor
    farthest = PointSource((0.0, math.tan(math.radians(extent_deg))), distance_um)
    shift = twin.shift_um(PointSource(farthest.tangent))[1] / twin.pixel_um
    more = math.ceil(4 * shift / max(simulated_psfs - 1, 1))
    psf = polychromatic_psf_bytes(
        twin,
        farthest,
        (sensor.rows // twin.superpixel + more, sensor.columns // twin.superpixel + more),
        twin.superpixel,
        at_least=1,
        shortest=shortest_nm(colours_of(twin, Light("white-led"), 1)),
    )
    frame = _BYTES_PER_PIXEL * sensor.rows * sensor.columns
    if psf_points == 1:
        return psf + frame
    support, channels = _map_of(twin, extent_deg, pitch_um / distance_um).support, sensor.channels
    shape = (psf_points**2, len(channels), *twin.psf_shape(support))
    several = FieldPsf(torch.empty(shape, device="meta"), torch.zeros(shape[0], 2))
    solver = Reconstructor(several.values[0], support, 0.0, field_psf=several)
    solver = solver.for_iterations(_FIELD_ITERATIONS)
    return frame + max(
        psf + _MAKING_BYTES * math.prod(shape), solver.working_bytes(shape[1], twin.shape)
    )


def field_points(extent_deg: float) -> int:
    """Points along a side of the field up to a half angle, between which PSFs are blended."""
    return 2 * math.ceil(extent_deg / _FIELD_STEP_DEG) + 1


def _map_of(twin: Twin, extent_deg: float, step: float) -> FieldMap:
    """Square of pixels up to an angle along its sides, and half a pitch more."""
    limit = math.tan(math.radians(extent_deg))
    extent = twin.shift_um(PointSource((0.0, limit)))[1] + step / 2 * twin.stack().reduced_um
    side = 2 * math.ceil(extent / twin.pixel_um + 1)
    return FieldMap(twin, PixelRectangle.centred(side, side, twin.shape))


def _radiance(field: FieldMap, at: Places) -> Tensor:
    """Dots of one size on the pixels, each shared by the four that it lies between."""
    support = field.support
    scene = torch.zeros(support.height, support.width, dtype=torch.float64)
    weight = field.solid_angle()
    rays = Rays.of(field.twin, (support.height, support.width))
    for tangent, place in zip(at, rays.places(at), strict=True):
        row, column = (math.floor(each) for each in place)
        down, right = place[0] - row, place[1] - column
        power = math.cos(math.radians(PointSource(tangent).angle_deg))
        for i, vertical in ((0, 1 - down), (1, down)):
            for j, horizontal in ((0, 1 - right), (1, right)):
                scene[row + i, column + j] += power * vertical * horizontal
    scene = scene / weight
    return (scene / scene.max()).float()
