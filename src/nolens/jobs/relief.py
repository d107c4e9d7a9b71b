"""A relief that was measured takes the place of the one that a camera describes."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import torch

from nolens.camera import Flat, OpenCamera, RandomLenslets, ReliefFile
from nolens.camera.part import PositiveLength
from nolens.errors import DataError, OptionError
from nolens.files import (
    CAMERA_FILE,
    HeightMap,
    camera_files,
    read_camera,
    read_height_map,
    readable,
    write_camera,
)
from nolens.jobs.copied import copied_curves
from nolens.jobs.fields import CAMERAS, FilePath, Name
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.relief_reach import check_points, continued, reach_deg
from nolens.jobs.run import Product, Run, Writer, job
from nolens.optics.measured import (
    Heights,
    ReliefFigures,
    Tilt,
    filled,
    levelled,
    relief_figures,
    resampled,
)
from nolens.quantities import Length
from nolens.twin import Twin, preview_model

RELIEF_FILE, RECORD_FILE = "relief.tif", "relief.json"
"""Heights and record, in the folder of the camera."""
_FILE, _PART, _RESULT = "What the file holds", "What was measured", "Result"
_MOST_BAD = 0.05


class ReliefOptions(JobOptions):
    """Put a relief that was measured on a microscope in the place of a camera's own.

    nolens camera relief paper heights.tif --pitch 0.5um --unit um --mirror -o measured

    nolens psf --camera measured -o psf.tif

    Then the twin simulates the part that was really made.

    A camera's relief has the rows and columns of its picture; a microscope shows the mask from
    the scene, as the mirror image of that. For a map of the replica give --mirror, also for one
    of its master, or for the mask.tif of either from nolens fabricate. For one of the mould,
    which is the mirror image of both, give --invert --turn 180 instead, and for the relief.tif
    of a camera neither. This is for a camera that stands upright, and for a mould turned over
    like a page; where the map lies otherwise, --turn it.
    """

    usage = "camera relief CAMERA MAP -o FOLDER"

    camera: Annotated[
        Name,
        Option(
            f"{CAMERAS}. All but the relief stays.",
            needed="the camera (nolens camera relief CAMERA MAP -o FOLDER)",
            role="camera",
            positional=True,
        ),
    ]
    map: Annotated[
        FilePath,
        Option(
            "Heights: .tif (grey, whole numbers or floats), or text: a table of heights, points x "
            "y z on a grid (y downwards), Gwyddion's data matrix, or .sdf (ISO 25178-71, ASCII). "
            "nan, Bad or nothing marks points that were not measured.",
            needed="the file of heights (nolens camera relief CAMERA MAP -o FOLDER)",
            role="input",
            positional=True,
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder of the new camera: camera.toml, relief.tif, the curves that the camera names, "
            "and relief.json, the record.",
            needed="the folder of the new camera (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    pitch: Annotated[
        PositiveLength | None,
        Option("Distance of the map's points, such as 0.5um.", _FILE, default="what the file says"),
    ] = None
    unit: Annotated[
        Literal["nm", "um", "mm", "m"] | None,
        Option(
            "Length that a value of 1 stands for: nm, um, mm or m; for points, x and y too.",
            _FILE,
            default="what the file says",
        ),
    ] = None
    full_scale: Annotated[
        PositiveLength | None,
        Option(
            "Height that the largest count of a .tif of whole numbers stands for, such as 20um.",
            _FILE,
        ),
    ] = None
    mirror: Annotated[bool, Option("Exchanges top and bottom.", _PART, default="off")] = False
    invert: Annotated[bool, Option("Takes heights for depths.", _PART, default="off")] = False
    turn: Annotated[
        Literal[0, 90, 180, 270],
        Option("Turns the map by 90, 180 or 270 degrees, anticlockwise, after --mirror.", _PART),
    ] = 0
    keep_tilt: Annotated[
        bool,
        Option(
            "Leaves the best-fit plane in, which is taken away otherwise.", _PART, default="off"
        ),
    ] = False
    grid: Annotated[
        PositiveLength | None,
        Option(
            "Distance of the points of the camera's relief.",
            _RESULT,
            default="that of the relief so far, or of the pixels",
        ),
    ] = None
    tile: Annotated[
        bool,
        Option(
            "Continues a map that is too small by reflection at its edges: then only the "
            "statistics of the pattern are right.",
            _RESULT,
            default="off",
        ),
    ] = False

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / RECORD_FILE

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief and record."""
        names = {"camera": CAMERA_FILE, "relief": RELIEF_FILE, "record": RECORD_FILE}
        return tuple(Written(what, self.output / name) for what, name in names.items())


@job
def replace_relief(run: Run[ReliefOptions]) -> Product[OpenCamera]:
    """Read a camera and a map, and write the camera with the map as its relief.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    opened = read_camera(options.camera)
    run.reads(camera_files(options.camera, opened.camera))
    reporter.advance("map", 0.0)
    measured = read_height_map(
        options.map, pitch=options.pitch, unit=options.unit, full_scale=options.full_scale
    )
    run.begin()
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
    described = opened.camera.mask.relief
    figures = {
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
        "measured": _figures(relief_figures(twin.mask.relief)),
        "described": None
        if isinstance(described, Flat)
        else _figures(relief_figures(bare.mask.relief)),
        "reach_deg": reach,
    }
    run.warn(*warnings)

    def commit(writers: Mapping[Path, Writer]) -> None:
        more = {str(path.relative_to(options.output)): write for path, write in writers.items()}
        write_camera(options.output, made.camera, made.relief_um, more=more)

    curves = copied_curves(options.camera, opened)
    return Product(
        made,
        figures,
        {options.output / name: write for name, write in curves.items()},
        outputs=(options.output / CAMERA_FILE, options.output / RELIEF_FILE),
        commit=commit,
    )


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
