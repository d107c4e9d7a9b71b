"""`nolens measure field`: how PSFs and a grid of dots change with the field angle."""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import OpenCamera, PsfEntry, develop
from nolens.errors import DataError, OptionError
from nolens.evaluate import clipped_cells, falls_to
from nolens.experiments.dot_grid import DotGrid, dot_grid, found_grid, grid_tangents
from nolens.experiments.off_axis import OffAxis, compared, off_axis, ray_curves
from nolens.experiments.virtual_experiment import Tick, VirtualExperiment
from nolens.files import (
    CAMERA_FILE,
    PSFS_FILE,
    InputFile,
    RunRecord,
    camera_files,
    check_output,
    read_camera,
    read_frame,
    read_psf,
    read_psf_set,
    readable,
    write_png,
    write_record,
    write_tiff32,
    write_together,
)
from nolens.files.plot_field import write_angles_plot, write_dots_plot
from nolens.jobs.clock import Clock
from nolens.jobs.cost import announce, check_memory, colours_of, cost_of, pattern_size
from nolens.jobs.measuring.field_options import MeasureFieldOptions
from nolens.jobs.measuring.rounded import rounded
from nolens.jobs.options import check_apart
from nolens.jobs.reporter import Reporter
from nolens.optics import PointSource
from nolens.quantities import Length
from nolens.twin import Light, Twin
from nolens.twin.point import shortest_nm
from nolens.twin.preview import distance_um, preview_model, relief_points

CORRELATIONS = (0.6, 0.3)
"""Down to the first a picture is good, below the second it is lost (`uvimprint`); the paper does
not say whether frames count by their own norms or, at one exposure, by the central one's."""
_FIELD_STEP_DEG = 12.5
"""From one field point to the next, between which PSFs are blended."""
_ITERATIONS = 300
_SIZE_UM = 50.0
"""The paper's light: a pinhole of 50 um."""
_REMEDY = "a camera with fewer pixels or a coarser grid of its relief needs less"


def told_angles(found: list[OffAxis]) -> dict[str, Any]:
    """Figures of PSFs from the side, in values that JSON has."""
    at = [each.angle_deg for each in found]
    told: dict[str, Any] = {"angles": [rounded(asdict(each)) for each in found]}
    for name in ("correlation", "correlation_one_exposure", "correlation_overlap"):
        values = [getattr(each, name) for each in found]
        if None not in values:
            told[f"{name}_falls_to_deg"] = {
                f"{level:g}": rounded(falls_to(level, at, values)) for level in CORRELATIONS
            }
    return told


def told_grid(grid: DotGrid) -> dict[str, Any]:
    """Figures of a grid of dots, in values that JSON has."""
    return {
        "good_deg": rounded(grid.good_deg),
        "distorted_deg": rounded(grid.distorted_deg),
        "lost_deg": rounded(grid.lost_deg),
        "pitch_found_mm": rounded(grid.pose.pitch_mm),
        "turned_deg": rounded(grid.pose.turned_deg),
        "cell_deg": rounded(grid.cell_deg),
        "dots": [rounded(asdict(dot)) for dot in grid.dots],
    }


def captured_off_axis(
    folder: Path, twin: Twin | None, tick: Tick
) -> tuple[list[OffAxis], float, list[str]]:
    """Compare the PSFs of a camera's folder that were captured at angles with the central one.

    Parameters
    ----------
    folder
        With its list of PSFs.
    twin
        The camera; None leaves out what follows from it.
    tick
        Called with the share that is done.

    Returns
    -------
    tuple
        One for each PSF, by angle, the central one first; the distance of the light in um; and
        sentences to show, one for each doubt.

    Raises
    ------
    DataError
        If there is no central PSF or none from the side, or they do not fit the camera.
    FileError
        If a file cannot be read.
    """
    central, others = _chosen(folder, read_psf_set(folder).psf)
    doubts = []
    first = read_psf(folder, central).mean(dim=0)
    if twin is not None and not math.isclose(central.cell.um, twin.cell_um, rel_tol=0.01):
        raise DataError(
            f"{central.file} has cells of {central.cell}, but a reconstruction with the camera "
            f"{twin.camera.name!r} has cells of {twin.cell_um:g} µm: give the camera that the PSFs "
            "are from (--camera)"
        )
    found = []
    for number, entry in enumerate(others):
        tick(number / len(others))
        pattern = first if entry is central else read_psf(folder, entry).mean(dim=0)
        clipped = clipped_cells(pattern)
        if clipped:
            doubts.append(
                f"{clipped} cells of {folder / entry.file}, many side by side, have its very "
                "largest value: it seems to be clipped. Take a shorter exposure"
            )
        found.append(compared(first, pattern, source_of(entry), central.cell.um, twin))
    return found, central.distance_um, doubts


def source_of(entry: PsfEntry) -> PointSource:
    """Light of a PSF: to the right of the axis, and above it, where rows count downwards."""
    right, up = (math.tan(angle.rad) for angle in entry.angle)
    return PointSource((-up, right), entry.distance_um)


def _chosen(folder: Path, entries: Sequence[PsfEntry]) -> tuple[PsfEntry, list[PsfEntry]]:
    """The central PSF, and all of its distance by angle; those of the distance with the most."""
    captured = [
        each
        for each in entries
        if each.kind == "captured" and (each.on_axis or each.frame == "sensor")
    ]
    groups: dict[float, list[PsfEntry]] = {}
    for entry in captured:
        groups.setdefault(entry.distance_um, []).append(entry)
    whole = [group for group in groups.values() if any(each.on_axis for each in group)]
    if not whole:
        raise DataError(
            f"{folder} has no captured PSF of a light straight ahead to compare others with: "
            "calibrate one (nolens calibrate), at the distance of those from the side"
        )
    group = max(whole, key=len)
    if len(group) == 1:
        raise DataError(
            f"{folder} has no captured PSF of a light from the side at the distance of "
            f"{group[0].file}: calibrate some at known angles (nolens calibrate)"
        )
    central = next(each for each in group if each.on_axis)
    return central, sorted(group, key=lambda each: source_of(each).angle_deg)


@dataclass(frozen=True)
class MeasureFieldOutcome:
    """What the measurement came to.

    Parameters
    ----------
    angles
        PSFs from the side, if those were measured.
    grid
        Dots, if those were.
    summary
        All figures, in values that JSON has.
    rays
        What rays say of the PSFs, see `ray_curves`; None without a description of the camera.
    """

    angles: list[OffAxis] | None
    grid: DotGrid | None
    summary: dict[str, Any]
    rays: dict[str, list[float]] | None = None


def measure_field(options: MeasureFieldOptions, reporter: Reporter) -> MeasureFieldOutcome:
    """Measure the field of view, and write the plot and picture that are asked for.

    Parameters
    ----------
    options
        What to measure, and where to write.
    reporter
        Sees notes, warnings and how far the work is.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used, or a target is not what it was said to
        be; then nothing is written.
    """
    clock = Clock()
    given = _camera(options)
    opened = None if given is None else read_camera(given)
    files = {} if given is None or opened is None else camera_files(given, opened.camera)
    files |= options.inputs
    if options.psfs is not None:
        files["PSFs"] = options.psfs / PSFS_FILE
    check_apart(options, files)
    for path, suffixes in (
        (options.plot, (".png",)),
        (options.output, (".png", ".tif", ".tiff")),
        (options.record, (".json",)),
    ):
        if path is not None:
            check_output(path, suffixes)
    warnings: list[str] = []
    if options.dots is not None:
        assert opened is not None
        outcome = _of_picture(options, opened)
    elif options.psfs is not None:
        outcome, warnings = _of_folder(options, opened, reporter)
    else:
        assert opened is not None
        outcome = _of_twin(options, opened, reporter)
    # A folder's list is only known to be there once it has been read.
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    for text in warnings:
        reporter.warn(text)
    summary = {
        **outcome.summary,
        "camera": None if opened is None else opened.camera.name,
        "warnings": warnings,
        "outputs": [readable(each.path) for each in options.written],
        "seconds": clock.seconds,
    }
    if options.record is not None:
        record = RunRecord(
            started=clock.started,
            inputs=inputs,
            parameters=options.model_dump(mode="json"),
            result=summary,
            history=[],
            warnings=warnings,
        )
        write_together(
            {options.record: partial(write_record, record=record), **_writers(options, outcome)}
        )
    return replace(outcome, summary=summary)


def _of_picture(options: MeasureFieldOptions, opened: OpenCamera) -> MeasureFieldOutcome:
    assert options.dots is not None and options.dot_pitch is not None
    frame = read_frame(options.dots)
    if frame.mosaic is not None:
        raise OptionError(
            f"{options.dots} is a raw file: reconstruct it first (nolens reconstruct), and give "
            "the picture as .tif"
        )
    picture = develop(frame, channels="all" if len(frame.channels) == 1 else "grey").values[0]
    assert isinstance(options.distance, Length)
    grid = found_grid(
        picture,
        preview_model(opened),
        pitch_um=options.dot_pitch.um,
        distance_um=options.distance.um,
        reach_deg=options.reach.deg,
    )
    return MeasureFieldOutcome(None, grid, told_grid(grid))


def _of_folder(
    options: MeasureFieldOptions, opened: OpenCamera | None, reporter: Reporter
) -> tuple[MeasureFieldOutcome, list[str]]:
    assert options.psfs is not None
    twin = None if opened is None else preview_model(opened)
    found, distance, doubts = captured_off_axis(
        options.psfs, twin, partial(reporter.advance, "PSFs")
    )
    told = {"distance_mm": _millimetres(distance), **told_angles(found)}
    rays = None if twin is None else ray_curves(twin, found[-1].angle_deg, distance)
    return MeasureFieldOutcome(found, None, told, rays), doubts


def _of_twin(
    options: MeasureFieldOptions, opened: OpenCamera, reporter: Reporter
) -> MeasureFieldOutcome:
    bare = preview_model(opened)
    away = distance_um(options.distance, opened)
    if options.dot_pitch is not None:
        at = grid_tangents(options.dot_pitch.um, away, options.reach.deg)
        farthest = PointSource((0.0, math.tan(options.reach.rad)), away)
        bare.check_source(farthest)
        points = 2 * math.ceil(options.reach.deg / _FIELD_STEP_DEG) + 1
        patterns = points**2
        tick: Callable[[float], None] = partial(reporter.advance, f"{len(at)} dots")
    else:
        farthest = PointSource((0.0, math.tan(options.angles[-1].rad)), away)
        bare.check_source(farthest)
        points, patterns = 1, len(options.angles) + 1
        tick = partial(reporter.advance, f"{len(options.angles)} point sources")
    _foretell(opened, bare, farthest, patterns, options, reporter)
    reporter.advance("mask", 0.0)
    bench = VirtualExperiment.of(opened, field_points=points)
    if options.dot_pitch is not None:
        grid = dot_grid(
            bench,
            pitch_um=options.dot_pitch.um,
            distance_um=away,
            reach_deg=options.reach.deg,
            iterations=_ITERATIONS,
            seed=options.seed,
            tick=tick,
        )
        told = {"distance_mm": _millimetres(away), **told_grid(grid)}
        return MeasureFieldOutcome(None, grid, told)
    found = off_axis(
        bench,
        [angle.deg for angle in options.angles],
        distance_um=away,
        diameter_um=0.0 if math.isinf(away) else _SIZE_UM,
        seed=options.seed,
        tick=tick,
    )
    told = {"distance_mm": _millimetres(away), **told_angles(found)}
    rays = ray_curves(bench.twin, options.angles[-1].deg, away)
    return MeasureFieldOutcome(found, None, told, rays)


def _foretell(
    opened: OpenCamera,
    bare: Twin,
    farthest: PointSource,
    patterns: int,
    options: MeasureFieldOptions,
    reporter: Reporter,
) -> None:
    """Say what the patterns will need; a reconstruction takes about as long as those of its dots.

    Patterns of a grid's field points have one sample to the pixel and are wider by a part of the
    region; those of single lights have two.
    """
    sensor = opened.camera.sensor
    light = Light("white-led")
    colours = colours_of(bare, light, 1)
    grid = options.dot_pitch is not None
    pixels = bare.cell_pixels if grid else 1
    rows, columns = sensor.rows // pixels, sensor.columns // pixels
    more = 0
    if grid:
        reach = bare.shift_um(PointSource(farthest.tangent))[1] / bare.cell_um
        more = math.ceil(4 * reach / (math.isqrt(patterns) - 1))
    size = pattern_size(
        bare,
        farthest,
        (rows + more, columns + more),
        pixels,
        at_least=1 if grid else 2,
        shortest=shortest_nm(colours),
    )
    cost = cost_of(
        size,
        patterns * len(colours) * (2 if grid else 1),
        points=relief_points(opened),
        held=8 * sensor.rows * sensor.columns * (patterns if not grid else 12),
    )
    device = torch.device("cpu")
    check_memory(cost, device, _REMEDY)
    announce(cost, device, reporter)


def _camera(options: MeasureFieldOptions) -> str | Path | None:
    """The camera that is named, or the one in the PSFs' folder; for a picture the paper's."""
    if options.simulate is not None:
        return options.simulate
    if options.psfs is None:
        return options.camera or "paper"
    if options.camera is None and (options.psfs / CAMERA_FILE).is_file():
        return options.psfs
    return options.camera


def _writers(
    options: MeasureFieldOptions, outcome: MeasureFieldOutcome
) -> dict[Path, Callable[[Path], None]]:
    writers: dict[Path, Callable[[Path], None]] = {}
    grid = outcome.grid
    if options.plot is not None and grid is not None:
        writers[options.plot] = partial(
            write_dots_plot,
            dots=grid.dots,
            picture=grid.picture,
            good_deg=grid.good_deg,
            lost_deg=grid.lost_deg,
        )
    elif options.plot is not None and outcome.angles is not None:
        writers[options.plot] = partial(
            write_angles_plot,
            curves={
                name: [getattr(each, name) for each in outcome.angles]
                for name in (
                    "angle_deg",
                    "correlation",
                    "correlation_one_exposure",
                    "correlation_overlap",
                    "light",
                )
            },
            rays=outcome.rays,
            levels=CORRELATIONS,
        )
    if options.output is not None and grid is not None:
        writers[options.output] = partial(_write_picture, picture=grid.picture[None])
    return writers


def _write_picture(path: Path, picture: Tensor) -> None:
    (write_png if path.suffix.lower() == ".png" else write_tiff32)(path, picture)


def _millimetres(away_um: float) -> float | None:
    return None if math.isinf(away_um) else away_um * 1e-3
