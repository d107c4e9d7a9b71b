"""`nolens measure resolution`: two points, Siemens star or slanted edge, seen or simulated."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from scipy import ndimage

from nolens.camera import OpenCamera
from nolens.errors import DataError
from nolens.evaluate import point_pair
from nolens.experiments.resolution import (
    POINT_ITERATIONS,
    POINTS_REGION,
    TARGET_ITERATIONS,
    TAU,
    EdgeResolution,
    FlatPicture,
    Screen,
    SeenPair,
    SolverSettings,
    StarResolution,
    TwoPoints,
    two_point_resolution,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import camera_files, read_camera
from nolens.files.plot_resolution import (
    ARC_PERIODS,
    EdgeCurves,
    PairPanel,
    StarCurves,
    plot_edge,
    plot_star,
    plot_two_points,
)
from nolens.jobs.cost import BYTES_OF_PROGRAM, check_memory
from nolens.jobs.measuring.resolution_options import (
    EdgeOptions,
    ResolutionOptions,
    SiemensOptions,
    TwoPointOptions,
)
from nolens.jobs.measuring.resolution_pictures import target_pictures
from nolens.jobs.run import Product, Run, Writer, job
from nolens.optics import PointSource
from nolens.quantities import Angle
from nolens.solvers import admm_bytes
from nolens.twin import FieldMap, Light, Twin
from nolens.twin.point import colour_pattern_bytes, colours_of, shortest_nm
from nolens.twin.preview import distance_um, preview_model, relief_points, simulation_bytes

Options = TypeVar("Options", bound=ResolutionOptions)
Value = TypeVar("Value")
_HALF, _TENTH = 0.5, 0.1
_DIGITS = 5
_MOST_PANELS = 6
_SIDE_CELLS = 24
_BYTES_PER_CELL = 20
"""Of PSF, frame and picture, which ADMM works on."""
_REMEDY = "a camera with fewer pixels, or a target of a smaller angle, needs less"
_SPOKES = 36
_ANGLE = Angle("20", "deg")
_SIZE_OFF = 0.1


def two_point_figures(found: TwoPoints) -> dict[str, Any]:
    """Dips by separation, and what is resolved."""
    resolved = found.resolved
    return {
        "target": "two-points",
        "resolved_deg": _short(resolved.value),
        "plus_minus_deg": _short(resolved.plus_minus),
        "largest_unresolved_deg": _short(resolved.unresolved),
        "smallest_resolved_deg": _short(resolved.resolved),
        "dip_needed": _short(found.threshold),
        "separations": [
            {
                "separation_deg": _short(angle),
                "dip": _short(dip),
                "dip_noise": _short(noise),
                "resolved": dip >= found.threshold,
            }
            for angle, dip, noise in zip(
                found.separations_deg, found.dips, found.noise, strict=True
            )
        ],
    }


def star_figures(found: StarResolution) -> dict[str, Any]:
    """Contrast by frequency and direction, and what is resolved."""
    star, worst = found.star, found.worst
    return {
        "target": "siemens",
        "resolved_deg": _short(found.resolved_everywhere_deg),
        "plus_minus_deg": _short(found.plus_minus_deg[worst]),
        "spoke_deg": _short(found.resolved_everywhere_deg / 2),
        "worst_direction_deg": _short(float(star.directions_deg[worst])),
        "finest_of_the_cells": found.at_limit[worst],
        "contrast_needed": _short(found.threshold * star.wide),
        "contrast_of_wide_spokes": _short(star.wide),
        "spokes": star.place.periods,
        "centre": [_short(each) for each in star.place.centre],
        "diameter_deg": _short(found.diameter_deg),
        "directions": [
            {
                "direction_deg": _short(float(star.directions_deg[number])),
                "resolved_deg": _short(found.resolved_deg[number]),
                "plus_minus_deg": _short(found.plus_minus_deg[number]),
                "cycles_per_deg": [_short(1 / each) for each in found.pairs_deg[number].tolist()],
                "contrast": [_short(each) for each in star.contrast[number].tolist()],
            }
            for number in range(len(found.resolved_deg))
        ],
    }


def edge_figures(found: EdgeResolution) -> dict[str, Any]:
    """Contrast by frequency across the edge."""
    response = found.response
    half, tenth = found.per_deg(_HALF), found.per_deg(_TENTH)
    return {
        "target": "edge",
        "resolved_deg": None if tenth is None else _short(1 / tenth),
        "half_contrast_per_deg": _short(half),
        "tenth_contrast_per_deg": _short(tenth),
        "tilt_deg": _short(response.tilt_deg),
        "direction_deg": _short(response.direction_deg),
        "cycles_per_deg": [_short(each / found.cell_deg) for each in response.frequencies.tolist()],
        "contrast": [_short(each) for each in response.transfer.tolist()],
    }


def _short(value: float | None) -> float | None:
    """Five digits: more is neither known nor worth the paper."""
    return None if value is None else float(f"{value:.{_DIGITS}g}")


def draw_two_points(path: Path, found: TwoPoints) -> None:
    """Pictures of the points with the light through them, and the dips by separation."""
    order = sorted(range(len(found.seen)), key=lambda n: abs(found.dips[n] - found.threshold))
    panels = []
    for number in sorted(order[:_MOST_PANELS]):
        each = found.seen[number]
        picture = each.picture.numpy()
        light = np.clip(picture, 0, None)
        middle = [round(at) for at in ndimage.center_of_mass(light**2)]
        top, left = (max(0, at - _SIDE_CELLS // 2) for at in middle)
        panels.append(
            PairPanel(
                each.separation_deg,
                found.dips[number],
                picture[top : top + _SIDE_CELLS, left : left + _SIDE_CELLS],
                each.pair.at.numpy(),
                each.pair.trace.numpy(),
            )
        )
    plot_two_points(
        path,
        panels,
        separations_deg=found.separations_deg,
        dips=found.dips,
        noise=found.noise,
        threshold=found.threshold,
        resolved_deg=found.resolved.value,
        plus_minus_deg=found.resolved.plus_minus,
    )


def draw_star(path: Path, found: StarResolution) -> None:
    """The star, its contrast by frequency and direction, and the light along an arc."""
    star = found.star
    turn = math.radians(float(star.directions_deg[found.worst]))
    pairs = found.pairs_deg[found.worst].numpy()
    at_limit = float(np.interp(found.resolved_everywhere_deg, pairs, star.radii.numpy()))
    traces = {}
    for times in (1.0, 1.2, 1.5):
        radius = times * at_limit
        if radius > float(star.radii[-1]):
            continue
        periods = np.linspace(-ARC_PERIODS / 2, ARC_PERIODS / 2, 241)
        turns = turn + periods * (2 * math.pi / star.place.periods)
        places = [
            star.place.centre[0] - radius * np.sin(turns),
            star.place.centre[1] + radius * np.cos(turns),
        ]
        light = ndimage.map_coordinates(found.picture.values.numpy(), places, order=3)
        traces[float(np.interp(radius, star.radii.numpy(), pairs))] = light
    plot_star(
        path,
        StarCurves(
            found.picture.values.numpy(),
            star.place.centre,
            at_limit,
            (1 / found.pairs_deg).numpy(),
            star.contrast.numpy(),
            star.directions_deg.numpy(),
            found.resolved_deg,
            found.worst,
            found.threshold * star.wide,
            traces,
        ),
    )


def draw_edge(path: Path, found: EdgeResolution) -> None:
    """The edge, the light across it and the contrast by frequency."""
    response = found.response
    plot_edge(
        path,
        EdgeCurves(
            found.picture.values.numpy(),
            response.at.numpy() * found.cell_deg,
            response.spread.numpy(),
            response.frequencies.numpy() / found.cell_deg,
            response.transfer.numpy(),
            {level: found.per_deg(level) for level in (0.5, 0.1)},
        ),
    )


@dataclass(frozen=True)
class ReadyBench:
    """A camera to simulate, before its relief is computed.

    Parameters
    ----------
    opened
        The camera.
    files
        Files it is read from, by role.
    light
        Spectrum of the light.
    wavelengths
        How many stand for a channel.
    distance_um
        Of the target.
    preview
        The camera with a stand-in for its relief.
    """

    opened: OpenCamera
    files: dict[str, Path]
    light: Light
    wavelengths: int
    distance_um: float
    preview: Twin

    @classmethod
    def of(cls, options: ResolutionOptions) -> "ReadyBench":
        """Read the camera.

        Raises
        ------
        NolensError
            If it, the light or the distance cannot be used.
        """
        assert options.simulate is not None
        opened = read_camera(options.simulate)
        bare = preview_model(opened)
        distance = distance_um(options.distance, opened)
        bare.check_source(PointSource((0.0, 0.0), distance))
        return cls(
            opened,
            camera_files(options.simulate, opened.camera),
            Light(options.light),
            options.wavelengths,
            distance,
            bare,
        )

    def cells_of(self, angle_deg: float) -> tuple[int, int]:
        """(rows, columns) of cells that a square target fills.

        Raises
        ------
        OptionError
            If it is beyond the model.
        """
        tangent = math.tan(math.radians(angle_deg) / 2)
        self.preview.check_source(PointSource((tangent, tangent), self.distance_um))
        region = FieldMap.covering(self.preview, (tangent, tangent)).region
        return region.height, region.width

    def needed(self, region: tuple[int, int]) -> float:
        """Bytes that are held at once where so many (rows, columns) of cells are solved for.

        Raises
        ------
        OptionError
            If the light cannot be used.
        """
        bare, sensor = self.preview, self.opened.camera.sensor
        colours = colours_of(bare, self.light, self.wavelengths)
        source = PointSource((0.0, 0.0), self.distance_um)
        pattern = colour_pattern_bytes(
            bare,
            source,
            (sensor.rows, sensor.columns),
            1,
            at_least=2,
            shortest=shortest_nm(colours),
        )
        cells = math.prod(a + b for a, b in zip(bare.cells, region, strict=True))
        # Channels are solved for one by one.
        held = admm_bytes(cells) + _BYTES_PER_CELL * cells
        return BYTES_OF_PROGRAM + simulation_bytes(relief_points(self.opened), pattern + held)

    def experiment(self, run: Run[Options], region: tuple[int, int]) -> VirtualExperiment:
        """Say what memory it takes to solve for a region, and compute the camera's relief.

        Raises
        ------
        OptionError
            If the machine has too little memory, or a file of the camera would be written over.
        """
        run.reads(self.files)
        needed = self.needed(region)
        check_memory(needed, run.device, _REMEDY)
        run.begin(needed)
        run.reporter.advance("mask", 0.0)
        return VirtualExperiment.of(
            self.opened, light=self.light.name, wavelengths=self.wavelengths
        )


@job
def measure_two_points(run: Run[TwoPointOptions]) -> Product[TwoPoints]:
    """Measure the dip between two points by separation, and the smallest resolved angle.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or a frame shows no two points; then
        nothing is written.
    """
    options = run.options
    settings = _settings(options, POINT_ITERATIONS)
    if options.simulate is None:
        assert options.distance is not None and options.distance != "infinity"
        seen = []
        pictures = target_pictures(run, settings.iterations)
        for separation, each in zip(options.separation, pictures, strict=True):
            angle = math.degrees(2 * math.atan(separation.um / options.distance.um / 2))
            pair = point_pair(each.picture, each.scale.cells(angle))
            seen.append(SeenPair(angle, pair, each.picture))
        found = TwoPoints.of(seen, options.dip.value)
    else:
        ready = ReadyBench.of(options)
        found = two_point_resolution(
            ready.experiment(run, (POINTS_REGION, POINTS_REGION)),
            ready.distance_um,
            direction_deg=options.direction.deg,
            draws=options.draws,
            threshold=options.dip.value,
            settings=settings,
            tick=partial(run.reporter.advance, "two points"),
        )
    resolved = found.resolved
    if resolved.value is None:
        run.warn(
            f"all separations are resolved: the smallest resolved angle is {resolved.resolved:.3g} "
            "deg or less"
            if resolved.unresolved is None
            else f"the largest separation, {resolved.unresolved:.3g} deg, is not resolved: take "
            "frames at larger ones"
        )
    return _product(options, settings, found, two_point_figures(found), draw_two_points)


@job
def measure_siemens(run: Run[SiemensOptions]) -> Product[StarResolution]:
    """Measure the contrast of a Siemens star in every direction.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such star; then
        nothing is written.
    """
    options, threshold = run.options, run.options.threshold.value
    settings = _settings(options, TARGET_ITERATIONS)
    if options.simulate is None:
        picture = _flat_picture(run, settings)
        found = StarResolution.of(picture, periods=options.spokes, threshold=threshold)
        _check_size(found, options)
    else:
        angle_deg = (options.angle or _ANGLE).deg
        screen = _screen(run, settings, angle_deg, "Siemens star")
        found = screen.star(angle_deg, options.spokes or _SPOKES, threshold)
    if any(found.at_limit):
        run.warn(
            "the finest spokes that the cells can show are resolved in some directions: a star of "
            "more spokes may show finer ones"
        )
    return _product(options, settings, found, star_figures(found), draw_star)


@job
def measure_edge(run: Run[EdgeOptions]) -> Product[EdgeResolution]:
    """Measure the contrast by frequency across a slanted edge.

    Raises
    ------
    NolensError
        If a file, an option or an output cannot be used, or the frame shows no such edge; then
        nothing is written.
    """
    options = run.options
    settings = _settings(options, TARGET_ITERATIONS)
    if options.simulate is None:
        found = EdgeResolution.of(_flat_picture(run, settings))
    else:
        angle_deg = options.angle.deg
        found = _screen(run, settings, angle_deg, "slanted edge").edge(angle_deg)
    return _product(options, settings, found, edge_figures(found), draw_edge)


def _settings(options: ResolutionOptions, iterations: int) -> SolverSettings:
    return SolverSettings(
        options.iterations or iterations, options.tau or TAU, options.fill.value, options.seed
    )


def _flat_picture(run: Run[Options], settings: SolverSettings) -> FlatPicture:
    """The only frame as a flat screen has it."""
    (each,) = target_pictures(run, settings.iterations)
    return each.scale.flat(each.picture)


def _screen(run: Run[Options], settings: SolverSettings, angle_deg: float, what: str) -> Screen:
    """In front of the camera to simulate, for a target of an angle."""
    ready = ReadyBench.of(run.options)
    experiment = ready.experiment(run, ready.cells_of(angle_deg))
    tick = partial(run.reporter.advance, what)
    return Screen(experiment, ready.distance_um, settings, tick)


def _product(
    options: ResolutionOptions,
    settings: SolverSettings,
    found: Value,
    figures: dict[str, Any],
    draw: Callable[[Path, Value], None],
) -> Product[Value]:
    """The figures, how their pictures were solved, and the plot if it is asked for."""
    reconstructs = options.simulate is not None or options.psf is not None
    figures |= {
        "simulated": options.simulate,
        "iterations": settings.iterations if reconstructs else None,
        "tau": settings.tau if reconstructs else None,
    }
    writers: dict[Path, Writer] = {}
    if options.plot is not None:
        writers[options.plot] = lambda path: draw(path, found)
    return Product(found, figures, writers)


def _check_size(found: StarResolution, options: SiemensOptions) -> None:
    """Refuse a star that is not as large as it was said to be."""
    if options.angle is None:
        return
    if abs(found.diameter_deg / options.angle.deg - 1) > _SIZE_OFF:
        raise DataError(
            f"the star in {options.frames[0]} is {found.diameter_deg:.3g} deg wide, not "
            f"{options.angle.deg:g} deg: check the angle of a cell (--camera, --cell-angle), the "
            "star's size and its distance"
        )
