"""`nolens refocus`: pictures at any depth of one measurement."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import AfterValidator
from torch import Tensor

from nolens.calibrate.distances import Layers
from nolens.calibrate.field_coverage import coverage_warnings
from nolens.camera import (
    FieldPsf,
    Measurement,
    PsfGeometry,
    arrange_rgb,
    develop,
    exposure_white,
    flipped,
)
from nolens.camera.part import refusal
from nolens.camera.psf_set import BEST_FIRST, Depth, depth_um
from nolens.errors import DataError, OptionError
from nolens.files import (
    CAMERA_FILE,
    PSFS_FILE,
    read_frame,
    read_psf_set,
    write_png,
    write_tiff16,
)
from nolens.files.psf_folder import PsfFolder
from nolens.files.stacks import STACK_FILES, stack_writers
from nolens.jobs.fields import (
    INPUT,
    SOLVER,
    Bgr,
    Bin,
    Black,
    Channels,
    ChosenTau,
    Dark,
    Device,
    FieldPoints,
    FilePath,
    Flat,
    Flip,
    Iterations,
    OutputFolderOptions,
    RawMosaic,
    ScenePrior,
    Support,
    White,
    parts,
    two_parts,
)
from nolens.jobs.options import Option, Written
from nolens.jobs.reconstruction.options import LESS_MEMORY, parse_support
from nolens.jobs.reconstruction.setup import stated_options
from nolens.jobs.run import Product, Run, Writer, check_solver_memory, job, mapped_where_needed
from nolens.operators import PixelRectangle
from nolens.ranges import Between
from nolens.refocusing import (
    AllInFocus,
    DepthField,
    DepthPsfs,
    DepthReconstructor,
    FocalStack,
    all_in_focus,
    depth_mm,
    even_depths,
    focal_stack,
    focus,
    per_m,
)
from nolens.solvers import Development, Prior

_FOCUSED_FILES = ("focused.png", "focused.tif")
_PLACE = r"([0-9]{1,6})\s*,\s*([0-9]{1,6})"
_MOST_STEPS = 200
_WINDOW_LINES = 1.5
"""Width of the smallest window that tells depths, in lines of the PSF."""
_DEPTH = "Depth"


def _range_um(depths: tuple[Depth, Depth]) -> tuple[float, float]:
    return depth_um(depths[0]), depth_um(depths[1])


def _near_first(depths: tuple[Depth, Depth]) -> tuple[Depth, Depth]:
    if not depth_um(depths[0]) < depth_um(depths[1]):
        raise refusal("the first depth must be nearer than the second, such as 8cm,50cm")
    return depths


_Row = Annotated[int, Between(0, 999_999)]
_Depths = Annotated[
    tuple[Depth, Depth],
    two_parts("give the nearest and the farthest depth, such as 8cm,50cm or 8cm,infinity"),
    AfterValidator(_near_first),
]


class RefocusOptions(OutputFolderOptions):
    """Focus a photograph at any depth, after it was taken.

    nolens refocus raw.dng --psfs camera -o out

    nolens refocus raw.dng --psfs camera --stack 8cm,50cm -o out

    Without --depth, autofocus chooses the depth: the one whose PSF explains the measurement best,
    or with --at the one that brings that place into focus.
    """

    usage = "refocus RAW --psfs FOLDER -o FOLDER"
    record_file = "refocus.json"

    measurement: Annotated[
        FilePath,
        Option(
            "What the sensor measured of the scene: camera raw, .png, .tif or .npy.",
            needed="the measurement (nolens refocus RAW --psfs FOLDER -o FOLDER)",
            role="input",
            positional=True,
            label="Raw file",
        ),
    ]
    psfs: Annotated[
        FilePath,
        Option(
            f"Folder with the camera's PSFs at some distances ({PSFS_FILE}, as nolens calibrate "
            "writes it), and camera.toml where there is one. Between distances PSFs are magnified.",
            needed=f"the folder with the camera's {PSFS_FILE} (--psfs FOLDER)",
            role="input",
            label="Camera",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder for the pictures: focused.png, focused.tif (16 bits, linear) and "
            "refocus.json (the record); with --stack also stack.tif (for ImageJ), sweep.png "
            "(animated), sweep.html (a page with a slider), all-in-focus.png, depth.png and "
            "depth.tif (mm).",
            needed="the folder for the pictures (-o FOLDER)",
            role="output",
            flag="-o",
        ),
    ]
    depth: Annotated[
        Depth | None,
        Option(
            "Distance to focus on, such as 8cm, or infinity.",
            default="by autofocus",
        ),
    ] = None
    at: Annotated[
        tuple[_Row, _Row] | None,
        parts(_PLACE, "give row and column of the picture in pixels, such as 120,200"),
        Option(
            "ROW,COLUMN of focused.png, in pixels: the place that is to be sharp, whatever its "
            "depth.",
            default="the whole picture",
        ),
    ] = None
    search: Annotated[
        _Depths | None,
        Option(
            "NEAR,FAR: depths between which autofocus searches, such as 8cm,infinity.",
            _DEPTH,
            default="the distances of the PSFs",
        ),
    ] = None
    stack: Annotated[
        _Depths | None,
        Option(
            "NEAR,FAR: pictures at depths from near to far, in equal steps of 1/distance. Without "
            "--depth or --at, focused.png is left out.",
            label="Nearest and Farthest",
        ),
    ] = None
    steps: Annotated[
        int, Between(2, _MOST_STEPS), Option("How many depths --stack has.", label="Depths")
    ] = 9
    support: Support = None
    tau: ChosenTau = "auto"
    dark: Dark = None
    flat: Flat = None
    black: Black = None
    white: White = None
    mosaic: RawMosaic = None
    bgr: Bgr = False
    channels: Channels = "all"
    bin: Annotated[Bin, Option("Average N×N pixels into one.", INPUT, label="Binning")] = 1
    prior: ScenePrior = Prior.TV
    field_points: FieldPoints = "auto"
    iterations: Annotated[
        Iterations,
        Option(
            "Limit of the iterations for a picture; while searching, at most 60.",
            SOLVER,
            label="Iterations, at most",
        ),
    ] = 100
    device: Device = "auto"
    flip: Flip = "none"

    def check_together(self) -> None:
        """Refuse a depth that is stated and sought, and steps or a search without their use."""
        if self.depth is not None:
            for name, value in (("at", self.at), ("search", self.search)):
                if value is not None:
                    raise OptionError(
                        f"--depth {self.depth} says the depth, and --{name} has it found: "
                        "leave one out"
                    )
        if "steps" in self.model_fields_set and self.stack is None:
            raise OptionError(
                f"--steps {self.steps} are those of a focal stack: say between which depths, "
                "such as --stack 8cm,50cm"
            )
        if self.search is not None and not self.focused:
            raise OptionError(
                "--search is for autofocus, and --stack alone needs none: add "
                "--at, or leave one out"
            )

    @property
    def focused(self) -> bool:
        """Whether a picture at one depth is written."""
        return self.stack is None or self.depth is not None or self.at is not None

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the PSFs."""
        files = super().inputs
        files["list of PSFs"] = files.pop("psfs") / PSFS_FILE
        camera = self.psfs / CAMERA_FILE
        return files | {"camera": camera} if camera.is_file() else files

    @property
    def written(self) -> tuple[Written, ...]:
        """Pictures, stack and record."""
        names: dict[str, str] = {}
        if self.focused:
            names |= dict(zip(("picture", "linear picture"), _FOCUSED_FILES, strict=True))
        if self.stack is not None:
            names |= STACK_FILES
        return self.in_folder(names)


@dataclass(frozen=True)
class Refocused:
    """Pictures of a refocusing.

    Parameters
    ----------
    picture
        Radiance at the depth that was asked for or found; None if only a stack was.
    stack, together
        The focal stack, and what it shows of the scene; None without one.
    """

    picture: Tensor | None = None
    stack: FocalStack | None = None
    together: AllInFocus | None = None


@job
def refocus(run: Run[RefocusOptions]) -> Product[Refocused]:
    """Find the depth, reconstruct, and write pictures, stack and record.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options = run.options
    read = partial(read_frame, mosaic=options.mosaic, bgr=options.bgr)
    measurement = develop(
        read(options.measurement),
        dark=read(options.dark) if options.dark else None,
        flat=read(options.flat) if options.flat else None,
        black=options.black,
        white=options.white,
        bin_by=options.bin,
        channels=options.channels,
    )
    psfs = read_depth_psfs(
        run,
        options.psfs,
        measurement,
        bin_by=options.bin,
        channels=options.channels,
        field_points=options.field_points,
    )
    farthest = psfs.at(psfs.distances_um[-1])
    support = None
    if options.support is not None:
        support = parse_support(options.support, measurement.size, farthest)
    reconstructor = DepthReconstructor(
        measurement,
        support,
        None if options.tau == "auto" else options.tau,
        options.prior,
        options.iterations,
        device=run.device,
    )
    size = measurement.size if support is None else (support.height, support.width)
    place = None if options.at is None else _upright_place(options.at, size, options.flip)
    depth = _depth_or_search(options, psfs)
    stated: list[float] = []
    if options.stack is not None:
        stated += even_depths(*_range_um(options.stack), options.steps)
        psfs.check_depths(stated, f"--stack {options.stack[0]},{options.stack[1]}")
    if isinstance(depth, float):
        stated.append(depth)
        psfs.check_depths([depth], f"--depth {options.depth}")
    run.warn(
        *psfs.warnings, *psfs.depth_warnings(stated, depth if isinstance(depth, tuple) else None)
    )
    sought = psfs.distances_um if isinstance(depth, tuple) else ()
    asked = stated_options(support=options.support, field_points=options.field_points)
    run.warn(*field_warnings(psfs, (*stated, *sought), measurement.size, support, asked))
    needed = mapped_where_needed(
        reconstructor.at(farthest, psfs.field_at(psfs.distances_um[-1])),
        measurement,
        LESS_MEMORY,
        run.reporter.note,
    )
    reconstructor = replace(reconstructor, mapped=needed.mapped)
    run.begin(check_solver_memory(needed, measurement, LESS_MEMORY))

    def picture_of(scene: Tensor) -> Tensor:
        return flipped(arrange_rgb(scene, measurement.channels), options.flip)

    step = partial(run.reporter.step, "iteration")
    weighed_um = depth if isinstance(depth, float) else psfs.middle_um
    reconstructor = reconstructor.weighted(psfs.at(weighed_um))
    figures = {**psfs.figures(), "tau": reconstructor.tau}
    result, stopped = Refocused(), False
    writers: dict[Path, Writer] = {}
    if depth is not None:
        focused = focus(
            reconstructor,
            psfs,
            depth,
            place,
            search_step=partial(step, result="the best depth"),
            step=partial(step, result="the picture"),
        )
        picture = picture_of(focused.result.photograph.cpu())
        exposure_white(picture)  # An empty picture is an error before anything is written.
        result, stopped = Refocused(picture), not focused.finished
        figures |= focused.figures()
        if focused.search is not None:
            run.warn(*focused.search.warnings)
        for name, write in zip(_FOCUSED_FILES, (write_png, write_tiff16), strict=True):
            writers[options.output / name] = partial(write, radiance=picture)
    if options.stack is not None and not stopped:
        depths = even_depths(*_range_um(options.stack), options.steps)
        stack = focal_stack(
            reconstructor,
            psfs.at,
            depths,
            partial(step, result="the depths"),
            field_at=psfs.field_at,
        )
        stack = replace(stack, pages=torch.stack([picture_of(page) for page in stack.pages]))
        together = all_in_focus(stack, _WINDOW_LINES * psfs.line)
        exposure_white(together.picture)  # As above.
        stopped = len(stack.pages) < len(depths)
        result = replace(result, stack=stack, together=together)
        figures["stack_mm"] = [depth_mm(each) for each in stack.depths_um]
        title = f"{options.measurement.name} refocused"
        writers |= stack_writers(options.output, stack, together, title)
    figures["stop_reason"] = "interrupted" if stopped else "finished"
    return Product(result, figures, writers)


def read_depth_psfs(
    run: Run[Any],
    folder: Path,
    measurement: Measurement,
    *,
    bin_by: int,
    channels: str,
    field_points: FieldPoints,
) -> DepthPsfs:
    """Read the PSFs that fit a measurement: straight ahead, and where a camera is known at angles.

    Raises
    ------
    NolensError
        If there is none straight ahead, or one does not fit.
    """
    entries = read_psf_set(folder).by_distance(BEST_FIRST)
    if not entries:
        raise DataError(
            f"the PSFs in {folder} are all of point sources beside the axis: refocusing "
            "needs those straight ahead, at several distances (nolens calibrate)"
        )
    files = {entry: folder / entry.file for entry in entries}
    run.reads({f"PSF {entry.file}": path for entry, path in files.items()})
    psfs = PsfFolder(folder)
    camera = None if psfs.camera is None else psfs.camera.camera
    depths = DepthPsfs.of_set(
        {entry: psfs.frame(entry) for entry in entries},
        measurement,
        camera,
        where=str(folder),
        bin_by=bin_by,
        channels=channels,
    )
    if camera is None or field_points == 1:
        return depths
    known = {
        distance: _field_psf(run, psfs, distance, measurement, bin_by, channels, field_points)
        for distance in depths.distances_um
    }
    if not any(known.values()):
        return depths
    pixel_um = bin_by * camera.sensor.superpixel * camera.sensor.pitch.um
    return replace(depths, field=DepthField(known, Layers.of_camera(camera), pixel_um))


def field_warnings(
    psfs: DepthPsfs,
    depths_um: Sequence[float],
    sensor: tuple[int, int],
    support: PixelRectangle | None,
    stated: str,
) -> list[str]:
    """About angles of a scene that PSFs over the field do not cover (`coverage_warnings`).

    Parameters
    ----------
    psfs
        Of a measurement.
    depths_um
        Of the scene.
    sensor
        (height, width) of the measurement.
    support
        Of the scene; None takes the sensor's frame.
    stated
        Options that ask for this scene or these PSFs.

    Raises
    ------
    OptionError
        If a scene that was asked for goes on far beyond them.
    """
    if psfs.field is None:
        return []
    known, texts = psfs.field.known, list[str]()
    # Each depth has the PSFs of the nearest distance.
    used = {min(known, key=lambda each: abs(per_m(each) - per_m(depth))) for depth in depths_um}
    for distance in sorted(used):
        field_psf, scene = known[distance], support or PixelRectangle(0, 0, *sensor)
        if field_psf is not None:
            texts += coverage_warnings(
                field_psf.places,
                scene,
                sensor,
                psfs.field.pixel_um,
                psfs.field.layers,
                stated,
            )
    return list(dict.fromkeys(texts))


def _field_psf(
    run: Run[Any],
    folder: PsfFolder,
    distance_um: float,
    measurement: Measurement,
    bin_by: int,
    channels: str,
    field_points: FieldPoints,
) -> FieldPsf | None:
    """All PSFs of a distance on the measurement's pixels; None where there is only one."""
    found = folder.for_scene(distance_um, None if field_points == "auto" else field_points)
    run.reads({f"PSF {each.file}": folder.path / each.file for each in found.entries})
    size = (measurement.size[0] * bin_by, measurement.size[1] * bin_by)
    development = Development(
        found.ahead,
        bin_by=bin_by,
        channels=channels,
        psf_geometry=PsfGeometry(extended=found.ahead.size != size),
        field_points=found.field_points,
    )
    return development.field_psf(measurement)


def _depth_or_search(
    options: RefocusOptions, psfs: DepthPsfs
) -> float | tuple[float, float] | None:
    """The depth of the picture, or two for autofocus to search between; None without one."""
    if not options.focused:
        return None
    if options.depth is not None:
        return depth_um(options.depth)
    if options.search is not None:
        return _range_um(options.search)
    near_um, far_um = psfs.distances_um[0], psfs.distances_um[-1]
    if near_um == far_um:
        raise OptionError(
            f"the folder {options.psfs} has PSFs of one distance only: say between which "
            "depths autofocus searches (--search 8cm,infinity), or where to focus (--depth "
            "8cm)"
        )
    return near_um, far_um


def _upright_place(place: tuple[int, int], size: tuple[int, int], flip: str) -> tuple[float, float]:
    """The place that is to be sharp, in the picture before it is turned over.

    Raises
    ------
    OptionError
        If it lies beside the picture.
    """
    (row, column), (rows, columns) = place, size
    if row >= rows or column >= columns:
        raise OptionError(
            f"--at {row},{column} lies beside the picture, which has {rows}×{columns} pixels: "
            f"give a row up to {rows - 1} and a column up to {columns - 1}"
        )
    return (
        rows - 1.0 - row if flip in ("vertical", "both") else float(row),
        columns - 1.0 - column if flip in ("horizontal", "both") else float(column),
    )
