"""A relief that was measured takes the place of the one that a camera describes."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch

from nolens.camera import Flat, OpenCamera, RandomLenslets, ReliefFile
from nolens.errors import DataError, OptionError
from nolens.files import (
    HeightMap,
    InputFile,
    RunRecord,
    camera_files,
    read_camera,
    read_height_map,
    readable,
    write_camera,
    write_record,
)
from nolens.files.folder import check_folder
from nolens.jobs.clock import Clock
from nolens.jobs.copied import copied_curves
from nolens.jobs.options import check_apart
from nolens.jobs.relief_options import RECORD_FILE, RELIEF_FILE, ReliefOptions
from nolens.jobs.relief_reach import check_points, continued, reach_deg
from nolens.jobs.reporter import Reporter
from nolens.optics.measured import Heights, Tilt, filled, levelled, resampled
from nolens.optics.roughness import ReliefFigures, relief_figures
from nolens.quantities import Length
from nolens.twin import Twin
from nolens.twin.preview import preview_model

_MOST_BAD = 0.05


@dataclass(frozen=True)
class ReliefOutcome:
    """A camera with a measured relief.

    Parameters
    ----------
    opened
        The camera.
    summary
        Figures of the map and of both reliefs, in values that JSON has.
    """

    opened: OpenCamera
    summary: dict[str, Any]


def replace_relief(options: ReliefOptions, reporter: Reporter) -> ReliefOutcome:
    """Read a camera and a map, and write the camera with the map as its relief.

    Parameters
    ----------
    options
        What to read, how it lies, where to write.
    reporter
        Sees notes, warnings and how far the work is.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    clock = Clock()
    opened = read_camera(options.camera)
    files = {**options.inputs, **camera_files(options.camera, opened.camera)}
    check_apart(options, files)
    check_folder(options.output)
    reporter.advance("map", 0.0)
    measured = read_height_map(
        options.map, pitch=options.pitch, unit=options.unit, full_scale=options.full_scale
    )
    inputs = {role: InputFile.of(path) for role, path in files.items()}
    warnings: list[str] = []
    reporter.advance("map", 0.4)
    heights, pitch_um, tilt = _prepared(measured, options, warnings)
    grid = _grid(options, opened)
    if max(pitch_um) > 1.5 * grid.um:
        warnings.append(
            f"the map has a point every {max(pitch_um):.3g} µm: what is finer on the part is not "
            "in it"
        )
    check_points(heights.shape, pitch_um, grid)
    heights = resampled(heights, pitch_um, grid.um)
    reporter.advance("map", 0.7)
    bare = preview_model(opened)
    if options.tile:
        heights = continued(heights, bare, grid, warnings)
    made = _with_relief(opened, heights, grid, options)
    twin = _twin(made)
    reach = reach_deg(twin)
    figures = relief_figures(twin.mask.relief)
    described = opened.camera.mask.relief
    summary = {
        "camera": made.camera.name,
        "map": {
            "format": measured.format,
            "points": list(measured.heights_um.shape),
            "pitch_um": [round(each, 6) for each in measured.pitch_um],
            "pitch_from": measured.pitch_from,
            "bad_points": int(np.isnan(measured.heights_um).sum()),
            "tilt_mrad": [round(each, 5) for each in tilt.rise_mrad],
            "tilt_removed": not options.keep_tilt,
            "bow_um": round(tilt.bow_um, 5),
        },
        "grid_um": grid.um,
        "measured": _figures(figures),
        "described": None
        if isinstance(described, Flat)
        else _figures(relief_figures(bare.mask.relief)),
        "reach_deg": reach,
        "outputs": [readable(each.path) for each in options.written],
    }
    for warning in warnings:
        reporter.warn(warning)
    summary["seconds"] = clock.seconds
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters=options.model_dump(mode="json"),
        result=summary,
        history=[],
        warnings=warnings,
    )
    write_camera(
        options.output,
        made.camera,
        made.relief_um,
        more={
            **copied_curves(options.camera, opened),
            RECORD_FILE: partial(write_record, record=record),
        },
    )
    return ReliefOutcome(made, summary)


def _prepared(
    measured: HeightMap, options: ReliefOptions, warnings: list[str]
) -> tuple[Heights, tuple[float, float], Tilt]:
    """Heights without gaps and tilt, lying as the camera's picture does."""
    bad = int(np.isnan(measured.heights_um).sum())
    share = bad / measured.heights_um.size
    if share > _MOST_BAD:
        raise DataError(
            f"{100 * share:.2g} % of the points of {options.map} are marked as bad, more than the "
            f"{100 * _MOST_BAD:g} % that can be filled from their neighbours: measure again, or "
            "cut out a better part"
        )
    if bad:
        warnings.append(
            f"{bad} points of the map ({100 * share:.2g} %) are marked as bad: they are filled "
            "from their neighbours"
        )
    heights = -measured.heights_um if options.invert else measured.heights_um
    pitch_um = measured.pitch_um
    if options.mirror:
        heights = heights[::-1]
    if options.turn in (90, 270):
        pitch_um = (pitch_um[1], pitch_um[0])
    heights = np.rot90(heights, options.turn // 90)
    flat, tilt = levelled(heights, pitch_um)
    return filled(heights if options.keep_tilt else flat), pitch_um, tilt


def _grid(options: ReliefOptions, opened: OpenCamera) -> Length:
    if options.grid is not None:
        return options.grid
    relief = opened.camera.mask.relief
    if isinstance(relief, RandomLenslets | ReliefFile):
        return relief.grid
    return opened.camera.sensor.pitch


def _with_relief(
    opened: OpenCamera, heights: Heights, grid: Length, options: ReliefOptions
) -> OpenCamera:
    """The camera with these heights as its relief, which remembers where they come from."""
    camera = opened.camera
    relief = ReliefFile(kind="file", file=RELIEF_FILE, grid=grid)
    name = readable(options.map.name)
    note = f"Its relief was measured: {name}."
    changed = camera.model_copy(
        update={
            "name": f"{camera.name}, relief of {name}",
            "note": f"{camera.note} {note}".strip(),
            "mask": camera.mask.model_copy(update={"relief": relief}),
        }
    )
    values = torch.from_numpy(np.ascontiguousarray(heights, dtype=np.float32))
    return replace(opened, camera=changed, relief_um=values)


def _twin(made: OpenCamera) -> Twin:
    try:
        return Twin.of(made)
    except OptionError as error:
        raise OptionError(
            f"{error} (--grid). Slopes of a measured map that steep can be its noise: smooth it in "
            "the microscope's software then"
        ) from None


def _figures(figures: ReliefFigures) -> dict[str, Any]:
    return {
        key: [round(each, 5) for each in value] if isinstance(value, tuple) else value
        for key, value in asdict(figures).items()
    }
