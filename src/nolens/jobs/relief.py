"""A relief that was measured takes the place of the one that a camera describes."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np

from nolens.camera import Flat, LoadedCamera
from nolens.camera.part import PositiveLength
from nolens.errors import DataError
from nolens.files import (
    CAMERA_FILE,
    HeightMap,
    camera_files,
    read_camera,
    read_height_map,
    readable,
    write_camera,
)
from nolens.files.cameras import curve_copies
from nolens.jobs.fields import CAMERAS, FilePath, Name, OutputFolderOptions
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Run, Writer, job
from nolens.optics import Relief
from nolens.optics.measured import Heights, Tilt, fill_gaps, oriented, relief_figures, remove_tilt
from nolens.twin import preview_model
from nolens.twin.measured_relief import extended, extent_deg, on_grid, relief_grid, with_relief

RELIEF_FILE = "relief.tif"
"""Heights, in the folder of the camera."""
_FILE, _PART, _RESULT = "What the file holds", "What was measured", "Result"
_MOST_BAD = 0.05


class ReliefOptions(OutputFolderOptions):
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
    record_file: ClassVar[str] = "relief.json"

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
            "statistics of the PSF are right.",
            _RESULT,
            default="off",
        ),
    ] = False

    @property
    def written(self) -> tuple[Written, ...]:
        """Description, relief and record."""
        return self.in_folder({"camera": CAMERA_FILE, "relief": RELIEF_FILE})


@job
def replace_relief(run: Run[ReliefOptions]) -> Product[LoadedCamera]:
    """Read a camera and a map, and write the camera with the map as its relief.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    camera = read_camera(options.camera)
    run.reads(camera_files(options.camera, camera.camera))
    reporter.advance("map", 0.0)
    measured = read_height_map(
        options.map, pitch=options.pitch, unit=options.unit, full_scale=options.full_scale
    )
    run.begin()
    warnings: list[str] = []
    reporter.advance("map", 0.4)
    heights, pitch_um, tilt = _prepared(measured, options, warnings)
    grid = options.grid or relief_grid(camera)
    if max(pitch_um) > 1.5 * grid.um:
        warnings.append(
            f"the map has a point every {max(pitch_um):.3g} µm: what is finer on the part is not "
            "in it"
        )
    heights = on_grid(heights, pitch_um, grid)
    reporter.advance("map", 0.7)
    preview = preview_model(camera)
    if options.tile:
        size_mm = " × ".join(f"{(count - 1) * grid.mm:.3g}" for count in heights.shape)
        points = heights.size
        heights = extended(heights, preview, grid)
        if heights.size > points:
            warnings.append(
                f"the map of {size_mm} mm is continued by reflection at its edges: the statistics "
                "of the PSF are those of the part, but not its details"
            )
    changed, twin = with_relief(
        camera, heights, grid, file=RELIEF_FILE, source=readable(options.map.name)
    )
    figures = {
        "camera": changed.camera.name,
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
        "extent_deg": extent_deg(twin),
        "measured": _figures(twin.mask.relief),
        "described": None
        if isinstance(camera.camera.mask.relief, Flat)
        else _figures(preview.mask.relief),
    }
    run.warn(*warnings)

    def commit(writers: Mapping[Path, Writer]) -> None:
        more = {str(path.relative_to(options.output)): write for path, write in writers.items()}
        write_camera(options.output, changed.camera, changed.relief_um, more=more)

    curves = curve_copies(options.camera, camera)
    return Product(
        changed,
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
    fraction = bad / measured.heights_um.size
    if fraction > _MOST_BAD:
        raise DataError(
            f"{100 * fraction:.2g} % of the points of {options.map} are marked as bad, more than "
            f"the {100 * _MOST_BAD:g} % that can be filled from their neighbours: measure again, "
            "or cut out a better part"
        )
    if bad:
        warnings.append(
            f"{bad} points of the map ({100 * fraction:.2g} %) are marked as bad: they are filled "
            "from their neighbours"
        )
    heights, pitch_um = oriented(
        measured.heights_um,
        measured.pitch_um,
        mirror=options.mirror,
        invert=options.invert,
        turn_deg=options.turn,
    )
    flat, tilt = remove_tilt(heights, pitch_um)
    return fill_gaps(heights if options.keep_tilt else flat), pitch_um, tilt


def _figures(relief: Relief) -> dict[str, Any]:
    return {
        key: [round(each, 5) for each in value] if isinstance(value, tuple) else value
        for key, value in asdict(relief_figures(relief)).items()
    }
