"""`nolens refocus`: pictures at any depth of one measurement."""

import math
import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import AfterValidator, BeforeValidator
from torch import Tensor

from nolens.camera import (
    Camera,
    Frame,
    Measurement,
    PsfEntry,
    PsfKind,
    arrange_rgb,
    develop,
    exposure_white,
    prepare_psf,
)
from nolens.camera.measurement import bin_mean
from nolens.camera.part import refusal
from nolens.camera.psf import edge_warning
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import (
    CAMERA_FILE,
    PSFS_FILE,
    read_camera,
    read_frame,
    read_psf,
    read_psf_set,
    write_png,
    write_tiff16,
)
from nolens.files.stacks import plot_depth, write_depths, write_slider, write_stack, write_sweep
from nolens.jobs.fields import (
    INPUT,
    MAIN,
    SOLVER,
    Bgr,
    Bin,
    Black,
    Channels,
    Dark,
    Device,
    FilePath,
    Flat,
    Flip,
    Iterations,
    OutputFolderOptions,
    RawMosaic,
    ScenePrior,
    Support,
    Tau,
    White,
)
from nolens.jobs.options import Option, Written
from nolens.jobs.reconstruction.options import oriented, parse_support
from nolens.jobs.run import Product, Reporter, Run, Writer, job
from nolens.quantities import Length
from nolens.ranges import Between
from nolens.refocusing import (
    AllInFocus,
    Autofocus,
    AutofocusResult,
    DepthReconstructor,
    FocalStack,
    PsfAt,
    PsfBetween,
    all_in_focus,
    cut_alike,
    depth_um,
    even_depths,
    explained_by,
    focal_stack,
    line_pixels,
    measured_reduced_um,
    per_m,
    reduced_um,
)
from nolens.solvers import Prior, admm_bytes

_FOCUSED_FILES = ("focused.png", "focused.tif")
_STACK_FILES = {
    "stack": "stack.tif",
    "sweep": "sweep.png",
    "page with a slider": "sweep.html",
    "picture that is sharp everywhere": "all-in-focus.png",
    "depth map": "depth.png",
    "depths": "depth.tif",
}
"""What is written into the folder."""
_PLACE = re.compile(r"([0-9]{1,6})\s*,\s*([0-9]{1,6})")
_MOST_STEPS = 200
_KINDS: tuple[PsfKind, ...] = ("stitched", "extended", "captured", "solved", "scaled")
"""Those that extend beyond the sensor first, and measured ones before computed ones."""
_OF_THE_SENSOR = ("captured", "solved")
_WINDOW_LINES = 1.5
"""Width of the smallest window that tells depths, in lines of the PSF."""
_DEPTH = "Depth"


def _in_um(depth: Depth) -> float:
    """A depth as the optics take it: the word is infinity."""
    return depth.um if isinstance(depth, Length) else math.inf


def _two_depths(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    parts = value.split(",")
    if len(parts) != 2:
        raise refusal("give the nearest and the farthest depth, such as 8cm,50cm or 8cm,infinity")
    return tuple(part.strip() for part in parts)


def _near_first(depths: tuple[Depth, Depth]) -> tuple[Depth, Depth]:
    if not _in_um(depths[0]) < _in_um(depths[1]):
        raise refusal("the first depth must be nearer than the second, such as 8cm,50cm")
    return depths


def _place(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    match = _PLACE.fullmatch(value.strip())
    if match is None:
        raise refusal("give row and column of the picture in pixels, such as 120,200")
    return int(match[1]), int(match[2])


_Row = Annotated[int, Between(0, 999_999)]
_Depths = Annotated[tuple[Depth, Depth], BeforeValidator(_two_depths), AfterValidator(_near_first)]


class RefocusOptions(OutputFolderOptions):
    """Focus a photograph at any depth, after it was taken.

    nolens refocus raw.dng --psfs camera -o out

    nolens refocus raw.dng --psfs camera --stack 8cm,50cm -o out

    Without --depth the sharpest depth is found: the one whose PSF explains the photograph best,
    or with --at the one at which that place is sharpest.
    """

    usage = "refocus RAW --psfs FOLDER -o FOLDER"
    record_file = "refocus.json"

    measurement: Annotated[
        FilePath,
        Option(
            "What the sensor measured: camera raw, .png, .tif or .npy.",
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
            "Distance that is to be sharp, such as 8cm, or infinity.",
            _DEPTH,
            default="the sharpest",
        ),
    ] = None
    at: Annotated[
        tuple[_Row, _Row] | None,
        BeforeValidator(_place),
        Option(
            "ROW,COLUMN of focused.png, in pixels: what is to be sharp.",
            _DEPTH,
            default="the whole picture",
        ),
    ] = None
    search: Annotated[
        _Depths | None,
        Option(
            "NEAR,FAR: depths between which the sharpest is sought, such as 8cm,infinity.",
            _DEPTH,
            default="the distances of the PSFs",
        ),
    ] = None
    stack: Annotated[
        _Depths | None,
        Option(
            "NEAR,FAR: pictures at depths from near to far, in equal steps of 1/distance. Without "
            "--depth or --at, focused.png is left out.",
            _DEPTH,
            label="Nearest and Farthest",
        ),
    ] = None
    steps: Annotated[int, Between(2, _MOST_STEPS), Option("How many.", _DEPTH, label="Depths")] = 9
    support: Support = None
    tau: Annotated[
        Tau, Option("Weight of the prior.", MAIN, default="1e-4", label="τ, weight of the prior")
    ] = 1e-4
    dark: Dark = None
    flat: Flat = None
    black: Black = None
    white: White = None
    mosaic: RawMosaic = None
    bgr: Bgr = False
    channels: Channels = "all"
    bin: Annotated[Bin, Option("Average N×N pixels into one.", INPUT, label="Binning")] = 1
    prior: ScenePrior = Prior.TV
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
                "--search looks for the sharpest depth, and --stack alone looks for none: add "
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
            names |= _STACK_FILES
        return self.in_folder(names)


@dataclass(frozen=True)
class _DepthPsfs:
    """The PSFs of a camera's folder, for the depths of one measurement.

    `between` has them on the pixels of their files, of which `bin_by` are one of the measurement's;
    `files` are theirs, by role, and `warnings` are sentences to show.
    """

    between: PsfBetween
    bin_by: int
    depth_of_focus_per_m: float
    files: dict[str, Path]
    warnings: tuple[str, ...]

    @property
    def distances_um(self) -> tuple[float, ...]:
        """The nearest first."""
        return tuple(each.distance_um for each in reversed(self.between.known))

    def at(self, depth_um: float) -> Tensor:
        """PSF of a depth on the measurement's pixels."""
        return bin_mean(self.between.at(depth_um), self.bin_by)


def _read_depth_psfs(options: RefocusOptions, measurement: Measurement) -> _DepthPsfs:
    """Read the PSFs of points straight ahead that fit a measurement."""
    folder = options.psfs
    entries = read_psf_set(folder).by_distance(_KINDS)
    if not entries:
        raise DataError(
            f"the PSFs in {folder} are all of point sources beside the axis: refocusing "
            "needs those straight ahead, at several distances (nolens calibrate)"
        )
    camera = read_camera(folder).camera if (folder / CAMERA_FILE).is_file() else None
    if camera is not None:
        _check_readout(measurement, camera, entries[0], options.bin)
    psfs = [PsfAt(_read_psf(options, entry, measurement), entry.distance_um) for entry in entries]
    # PSFs beyond the sensor where there are any, all of one size.
    wide = [
        each
        for each in psfs
        if tuple(side // options.bin for side in each.psf.shape[-2:]) != measurement.size
    ]
    known = cut_alike(wide or psfs)
    reduced, warnings = _reduced_distance(known, entries[0], camera, folder)
    between = PsfBetween.of(known, reduced)
    sensor = measurement.size[0] * options.bin, measurement.size[1] * options.bin
    edge = None if wide else edge_warning(entries[0].file, known[0].psf, sensor)
    if edge is not None:
        warnings.append(edge)
    for near_um, far_um, alike in between.gaps:
        warnings.append(
            f"the depth set has a gap: brought to one size, the PSFs of {near_um * 1e-3:.4g} mm "
            f"and {far_um * 1e-3:.4g} mm are alike to {100 * alike:.0f} % only, so depths between "
            "them come out worse: calibrate one between"
        )
    return _DepthPsfs(
        between,
        options.bin,
        known[0].depth_of_focus_per_m(reduced, sensor),
        {f"PSF {each.file}": folder / each.file for each in entries},
        tuple(warnings),
    )


def _check_readout(measurement: Measurement, camera: Camera, entry: PsfEntry, bin_by: int) -> None:
    """Refuse a photograph that was read out in another way than the PSFs."""
    pixels = round(entry.pixel.um / camera.sensor.pitch.um)
    sides = camera.sensor.rows, camera.sensor.columns
    rows, columns = (count // max(1, pixels) // bin_by for count in sides)
    if measurement.size != (rows, columns):
        raise DataError(
            f"{measurement.source} has {measurement.size_text} pixels, but the sensor of the "
            f"camera {camera.name!r} has {rows}×{columns} of the PSFs' {entry.pixel}: give a "
            "photograph that was read out like the PSFs, uncut"
        )


def _read_psf(options: RefocusOptions, entry: PsfEntry, measurement: Measurement) -> Tensor:
    """A PSF on the pixels of its file, in the measurement's channels; checked against it."""
    counts = read_psf(options.psfs, entry)
    path = str(options.psfs / entry.file)
    frame = Frame(counts, entry.channels, None, (0.0,), None, "float32", path, black_stated=True)
    channels = "all" if len(entry.channels) == 1 else options.channels
    own = develop(frame, bin_by=options.bin, channels=channels)
    wider = own.size != measurement.size
    if wider and entry.kind in _OF_THE_SENSOR:
        raise DataError(
            f"the PSF {path} was {entry.kind} with {own.size_text} pixels, but the measurement "
            f"{measurement.source} has {measurement.size_text}: give a photograph that was read "
            "out like the PSFs"
        )
    prepare_psf(own, measurement, wider=wider)
    return develop(frame, channels=channels).values.clamp_min(0)


def _reduced_distance(
    known: list[PsfAt], entry: PsfEntry, camera: Camera | None, folder: Path
) -> tuple[float, list[str]]:
    """Reduced distance of mask and sensor, and a warning where camera and PSFs disagree."""
    measured = measured_reduced_um(known)
    described = None if camera is None else reduced_um(camera, camera.mask.surface)
    if measured is None and described is None:
        one = len({each.distance_um for each in known}) == 1
        have = f"is one PSF only, of {entry.distance}" if one else "are PSFs as large as each other"
        raise OptionError(
            f"in {folder} there {have}, and nothing says how it changes with the distance: "
            f"calibrate a second, much nearer one, or put the camera's {CAMERA_FILE} there"
        )
    if measured is None or (described is not None and explained_by(described, known, measured)):
        assert described is not None
        return described, []
    if described is None:
        return measured, []
    return measured, [
        f"the PSFs change with the distance as if mask and sensor were {measured * 1e-3:.3g} mm "
        f"apart (in air), but by {CAMERA_FILE} it is {described * 1e-3:.3g} mm: the PSFs' is "
        "taken; check the distances they were taken at"
    ]


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
    psfs = _read_depth_psfs(options, measurement)
    run.reads(psfs.files)
    farthest = psfs.at(psfs.distances_um[-1])
    region = None
    if options.support is not None:
        region = parse_support(options.support, measurement.size, farthest)
    reconstructor = DepthReconstructor(
        measurement, region, options.tau, options.prior, options.iterations, device=run.device
    )
    refocusing = _Refocusing(options, psfs, reconstructor, run.reporter)
    run.warn(*refocusing.warnings())
    run.begin(admm_bytes(reconstructor.problem(farthest).padded_pixels))

    figures: dict[str, Any] = {
        "depth_of_focus_per_m": psfs.depth_of_focus_per_m,
        "mask_to_sensor_um": psfs.between.reduced_um,
        "psf_distances_mm": [_in_mm(each) for each in psfs.distances_um],
    }
    result, stopped = Refocused(), False
    writers: dict[Path, Writer] = {}
    if options.focused:
        picture, search = refocusing.focused()
        result, stopped = Refocused(picture), search is not None and not search.finished
        figures |= refocusing.figures(search)
        if search is not None and search.finished and search.at_end:
            end = _in_mm(search.depth_um)
            if end != "infinity":
                run.warn(
                    f"the sharpest depth is the end of those that were looked at, {end} mm: the "
                    "true one may lie beyond (--search)"
                )
        for name, write in zip(_FOCUSED_FILES, (write_png, write_tiff16), strict=True):
            writers[options.output / name] = partial(write, radiance=picture)
    if options.stack is not None and not stopped:
        stack, together, stopped = refocusing.stack()
        result = replace(result, stack=stack, together=together)
        figures["stack_mm"] = [_in_mm(each) for each in stack.depths_um]
        title = f"{options.measurement.name} refocused"
        writers |= _stack_writers(options.output, stack, together, title)
    figures["stop_reason"] = "interrupted" if stopped else "finished"
    return Product(result, figures, writers)


class _Refocusing:
    """A measurement to be focused, all checked before the first depth is reconstructed.

    Raises an OptionError if a place lies beside the picture, or nothing says where to look for the
    sharpest depth.
    """

    def __init__(
        self,
        options: RefocusOptions,
        psfs: _DepthPsfs,
        reconstructor: DepthReconstructor,
        reporter: Reporter,
    ) -> None:
        self._options, self._psfs = options, psfs
        self._reconstructor, self._reporter = reconstructor, reporter
        self._at = self._upright_place()
        self._depth = None if options.depth is None else _in_um(options.depth)
        self._range = self._search_range() if options.focused and self._depth is None else None

    def focused(self) -> tuple[Tensor, AutofocusResult | None]:
        """Picture at the depth that is asked for, or at the sharpest one."""
        search = None
        if self._range is not None:
            autofocus = Autofocus(
                self._reconstructor, self._psfs.at, *self._range, self._psfs.depth_of_focus_per_m
            )
            search = autofocus.run(self._at, partial(self._step, kept="the sharpest depth"))
        limit = self._reconstructor.iterations

        def advance(iteration: int) -> bool:
            # After a search that was ended, the picture at its depth is still to be made.
            stop = self._step(iteration, limit, kept="the picture")
            return stop and (search is None or search.finished)

        psf = self._psfs.at(self._depth_um(search))
        result = self._reconstructor.solve(psf, lambda progress: advance(progress.iteration))
        picture = self._picture(result.photograph.cpu())
        exposure_white(picture)  # An empty picture is an error before anything is written.
        return picture, search

    def stack(self) -> tuple[FocalStack, AllInFocus, bool]:
        """All depths of the stack, and whether it was ended before the last one."""
        assert self._options.stack is not None
        near, far = self._options.stack
        depths = even_depths(_in_um(near), _in_um(far), self._options.steps)
        stack = focal_stack(
            self._reconstructor, self._psfs.at, depths, partial(self._step, kept="the depths")
        )
        stack = replace(stack, pages=torch.stack([self._picture(page) for page in stack.pages]))
        line = line_pixels(self._psfs.between.known[0].psf) / self._psfs.bin_by
        together = all_in_focus(stack, _WINDOW_LINES * line)
        exposure_white(together.picture)  # As above.
        return stack, together, len(stack.pages) < len(depths)

    def figures(self, search: AutofocusResult | None) -> dict[str, Any]:
        """Figures of the picture at one depth."""
        depth = self._depth_um(search)
        half = self._psfs.depth_of_focus_per_m / 2
        figures: dict[str, Any] = {
            "depth_mm": _in_mm(depth),
            "sharp_from_mm": _in_mm(depth_um(per_m(depth) + half)),
            "sharp_to_mm": _in_mm(depth_um(max(0, per_m(depth) - half))),
        }
        if search is not None:
            figures["tried"] = [
                {
                    "depth_mm": _in_mm(each.depth_um),
                    "objective": each.objective,
                    "sharpness": each.sharpness,
                }
                for each in search.tried
            ]
        return figures

    def warnings(self) -> list[str]:
        """What can be said before the work begins."""
        texts = list(self._psfs.warnings)
        room, distances = self._psfs.depth_of_focus_per_m, self._psfs.distances_um
        depths = list(self._range or ())
        if self._depth is not None:
            depths.append(self._depth)
        if self._range is not None and per_m(self._range[0]) - per_m(self._range[1]) < room:
            texts.append(
                f"all depths that are looked at lie within one depth of focus ({room:.3g}/m in "
                "1/z): they look alike, and which one is found means little"
            )
        if self._options.stack is not None:
            depths += [_in_um(each) for each in self._options.stack]
        least, most = per_m(distances[-1]), per_m(distances[0])
        if not all(least - room <= per_m(each) <= most + room for each in depths):
            have = " to ".join(
                f"{_in_mm(each)} mm" if math.isfinite(each) else "infinity"
                for each in dict.fromkeys((distances[0], distances[-1]))
            )
            texts.append(
                f"the PSFs are of {have}; beyond, they are magnified as rays are, which leaves out "
                "what the distance does to the mask's focus: calibrate at such a distance for more"
            )
        return texts

    def _upright_place(self) -> tuple[float, float] | None:
        """The place that is to be sharp, in a picture that is not turned over."""
        if self._options.at is None:
            return None
        region, flip = self._reconstructor.region, self._options.flip
        row, column = self._options.at
        size = self._reconstructor.measurement.size
        rows, columns = size if region is None else (region.height, region.width)
        if row >= rows or column >= columns:
            raise OptionError(
                f"--at {row},{column} lies beside the picture, which has {rows}×{columns} pixels: "
                f"give a row up to {rows - 1} and a column up to {columns - 1}"
            )
        return (
            rows - 1.0 - row if flip in ("vertical", "both") else float(row),
            columns - 1.0 - column if flip in ("horizontal", "both") else float(column),
        )

    def _search_range(self) -> tuple[float, float]:
        """Depths between which the sharpest one is sought."""
        if self._options.search is not None:
            near, far = self._options.search
            return _in_um(near), _in_um(far)
        near_um, far_um = self._psfs.distances_um[0], self._psfs.distances_um[-1]
        if near_um == far_um:
            raise OptionError(
                f"the folder {self._options.psfs} has PSFs of one distance only: say between which "
                "depths the sharpest is to be found (--search 8cm,infinity), or the depth (--depth "
                "8cm)"
            )
        return near_um, far_um

    def _depth_um(self, search: AutofocusResult | None) -> float:
        if search is not None:
            return search.depth_um
        assert self._depth is not None
        return self._depth

    def _picture(self, scene: Tensor) -> Tensor:
        rgb = arrange_rgb(scene, self._reconstructor.measurement.channels)
        return oriented(rgb, self._options.flip)

    def _step(self, done: int, limit: int, *, kept: str) -> bool:
        return self._reporter.step("iteration", done, limit, kept)


def _stack_writers(
    folder: Path, stack: FocalStack, together: AllInFocus, title: str
) -> dict[Path, Writer]:
    """What writes each file of a stack; all pictures have the white of the one sharp everywhere."""
    white = exposure_white(together.picture)
    depths = stack.depths_um
    pages: dict[str, Any] = {"pages": stack.pages, "depths_um": depths, "white": white}
    writers: dict[str, Writer] = {
        "stack": partial(write_stack, **pages),
        "sweep": partial(write_sweep, **pages, places=stack.places),
        "page with a slider": partial(
            write_slider,
            **pages,
            title=title,
            places=stack.places,
            everywhere=together.picture,
            sharpest=stack.nearest_pages(together.per_m),
        ),
        "picture that is sharp everywhere": partial(write_png, radiance=together.picture),
        "depth map": partial(
            plot_depth, per_m=together.per_m, confidence=together.confidence, depths_um=depths
        ),
        "depths": partial(write_depths, per_m=together.per_m),
    }
    return {folder / _STACK_FILES[what]: write for what, write in writers.items()}


def _in_mm(depth: float) -> float | str:
    """A depth in um as JSON has it: mm, or the word infinity."""
    return "infinity" if math.isinf(depth) else round(depth * 1e-3, 3)
