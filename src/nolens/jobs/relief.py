"""A relief that was measured takes the place of the one that a camera describes."""

from typing import Annotated, ClassVar, Literal

from nolens.camera import LoadedCamera
from nolens.camera.part import PositiveLength
from nolens.files import (
    CAMERA_FILE,
    read_height_map,
    readable,
    write_camera,
)
from nolens.files.cameras import curve_copies
from nolens.jobs.fields import CAMERAS, FilePath, Name, OutputFolderOptions
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.twin.measured_relief import measured_relief

RELIEF_FILE = "relief.tif"
"""Heights, in the folder of the camera."""
_PART, _RESULT = "What was measured", "Result"


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
            f"Camera whose relief is replaced: {CAMERAS}. All else stays.",
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
        Option("Distance of the map's points, such as 0.5um.", default="what the file says"),
    ] = None
    unit: Annotated[
        Literal["nm", "um", "mm", "m"] | None,
        Option(
            "Length that a value of 1 stands for: nm, um, mm or m; for points, x and y too.",
            default="what the file says",
        ),
    ] = None
    full_scale: Annotated[
        PositiveLength | None,
        Option(
            "Height that the largest count of a .tif of whole numbers stands for, such as 20um.",
        ),
    ] = None
    mirror: Annotated[bool, Option("Exchanges top and bottom: see above.", default="off")] = False
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
    camera = run.camera(options.camera)
    reporter.advance("map", 0.0)
    measured = read_height_map(
        options.map, pitch=options.pitch, unit=options.unit, full_scale=options.full_scale
    )
    run.begin()
    reporter.advance("map", 0.4)
    result = measured_relief(
        camera,
        measured.heights_um,
        measured.pitch_um,
        file=RELIEF_FILE,
        source=readable(options.map.name),
        grid=options.grid,
        mirror=options.mirror,
        invert=options.invert,
        turn_deg=options.turn,
        keep_tilt=options.keep_tilt,
        tile=options.tile,
        progress=lambda fraction: reporter.advance("map", 0.4 + 0.6 * fraction),
    )
    run.warn(*result.warnings)
    changed = result.camera
    figures = {
        "camera": changed.camera.name,
        "map": {
            "format": measured.format,
            "points": list(measured.heights_um.shape),
            "pitch_um": [round(each, 6) for each in measured.pitch_um],
            "pitch_from": measured.pitch_from,
            "bad_points": result.bad_points,
            "tilt_mrad": [round(each, 5) for each in result.tilt.rise_mrad],
            "tilt_removed": not options.keep_tilt,
            "bow_um": round(result.tilt.bow_um, 5),
        },
        **result.figures,
    }

    curves = curve_copies(options.camera, camera)
    return Product(
        changed,
        figures,
        {options.output / name: write for name, write in curves.items()},
        outputs=(options.output / CAMERA_FILE, options.output / RELIEF_FILE),
        commit=lambda files: write_camera(
            options.output, changed.camera, changed.relief_um, more=files
        ),
    )
