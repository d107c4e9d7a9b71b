"""What all targets of `nolens measure resolution` share: options, pictures, results, names."""

import math
from abc import abstractmethod
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, TypeVar

from pydantic import AfterValidator
from torch import Tensor

from nolens.amounts import rounded
from nolens.camera import FieldPsf, LoadedCamera, Measurement, develop
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.evaluate import FlatPicture
from nolens.experiments.resolution import (
    TARGET_ITERATIONS,
    TAU,
    AngularScale,
    ScreenTarget,
    SimulatedTarget,
    SolverSettings,
)
from nolens.experiments.virtual_experiment import VirtualExperiment, solved
from nolens.files import PSFS_FILE, read_frame
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    FilePath,
    Files,
    Iterations,
    Name,
    PsfExtent,
    RecordedOptions,
    Seed,
    Tau,
    Window,
    Word,
)
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.reconstruction.options import list_of_folder, parse_window
from nolens.jobs.reconstruction.setup import read_psfs
from nolens.jobs.run import Job, Product, Run
from nolens.operators import PixelRectangle
from nolens.plugins import Registry
from nolens.progress import part_of
from nolens.quantities import Angle, Percentage
from nolens.ranges import Between
from nolens.solvers import Development, PsfSettings, choose_psf
from nolens.twin import Light, distance_um, preview_model

Threshold = Annotated[Percentage, Between("0.01 %", "99.99 %")]
_PixelAngle = Annotated[Angle, Between("0.000001 deg", "10 deg")]
TargetAngle = Annotated[Angle, Between("0.001 deg", "89.9 deg")]
_FRAMES_ONLY = ("psf", "psf_extent", "dark", "support", "camera", "pixel_angle")
_SIMULATED_ONLY = ("light", "wavelengths", "fill", "seed")
_LINEAR = (".tif", ".tiff", ".npy")
_DIGITS = 5
"""Of figures: more is neither known nor worth the paper."""
_REMEDY = "a camera with fewer pixels, or a target of a smaller angle, needs less"
TARGET, _FRAMES, SIMULATION, _SOLVER = "Target", "Frames", "Simulation", "Solver"
"""Headings."""
Options = TypeVar("Options", bound="ResolutionOptions")
Value = TypeVar("Value")


def frames_option(text: str) -> Option:
    """Declare the frames of a target, with a text of its own."""
    return Option(text, role="input", what="frame", positional=True, label="Picture")


class ResolutionOptions(RecordedOptions):
    """What all targets have in common.

    Attributes
    ----------
    default_iterations
        Of ADMM, where none are given.
    """

    default_iterations: ClassVar[int] = TARGET_ITERATIONS

    frames: Annotated[
        Files,
        frames_option(
            "Raw frames of the target, or pictures of it that nolens reconstruct wrote (.tif, "
            ".npy)."
        ),
    ] = ()
    distance: Annotated[
        Depth | None,
        Option(
            "Distance from the camera to the target, such as 300mm.",
            default="the simulated camera's reference_distance",
            label="Distance",
        ),
    ] = None
    psf: Annotated[
        Annotated[FilePath, AfterValidator(list_of_folder)] | None,
        Option(
            "PSF to reconstruct raw frames with, captured at that distance; or a camera's folder "
            f"({PSFS_FILE}), whose PSFs at several angles are used together.",
            role="input",
            what="PSF",
        ),
    ] = None
    psf_extent: PsfExtent = "auto"
    dark: Annotated[
        FilePath | None, Option("Dark frame.", _FRAMES, role="input", what="dark frame")
    ] = None
    support: Annotated[
        Window | None,
        Option(
            "Scene pixels that light can come from, as nolens reconstruct takes it; of pictures, "
            "those that they show.",
            _FRAMES,
            default="the sensor's; of pictures, as many around its middle",
            former="region",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            f"Camera that took the frames: {CAMERAS}. It gives the angles of scene pixels.",
            default="camera.toml beside the PSF",
            role="camera",
            label="Camera",
        ),
    ] = None
    pixel_angle: Annotated[
        _PixelAngle | None,
        Option(
            "The angle of a scene pixel in the middle, in place of a camera, such as 0.138deg.",
            _FRAMES,
            former="cell_angle",
        ),
    ] = None
    simulate: Annotated[
        Name | None,
        Option(
            f"Camera to simulate in place of frames: {CAMERAS}.",
            role="camera",
            label="Camera",
        ),
    ] = None
    light: Annotated[Word, Option(f"{LIGHTS}.", SIMULATION, label="Light")] = "white-led"
    wavelengths: Annotated[
        int,
        Between(1, 64),
        Option(
            "How many stand for a channel of the sensor.",
            SIMULATION,
            label="Wavelengths of a channel",
        ),
    ] = 1
    fill: Annotated[
        Percentage,
        Between("0.001 %", "100 %"),
        Option(
            "Fraction of a full pixel that the brightest one is exposed to.",
            SIMULATION,
            label="Exposure of the brightest pixel",
        ),
    ] = Percentage("90", "%")
    seed: Annotated[Seed, Option("Of the noise.", SIMULATION)] = 0
    iterations: Annotated[
        Iterations | None,
        Option(
            "Of ADMM; all of them are done.",
            _SOLVER,
            default="300; two points 100",
            label="Iterations",
        ),
    ] = None
    tau: Annotated[
        Tau | None,
        Option("Weight of the prior.", _SOLVER, default="5e-6", label="τ, weight of the prior"),
    ] = None
    plot: Annotated[
        FilePath | None,
        Option(
            "Picture to write (.png) of what was measured. The record of the run goes beside it, "
            "as .json.",
            role="output",
            suffixes=(".png",),
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse all but one of frames and a simulation, and options that go with the other."""
        if not self.frames and self.simulate is None:
            raise OptionError(
                "nothing to measure is given: name frames or pictures of the target, or a camera "
                "to simulate (--simulate CAMERA)"
            )
        if self.frames and self.simulate is not None:
            raise OptionError(
                f"{self.frames[0]} and --simulate {self.simulate} are both given: measure "
                "frames, or simulate a camera"
            )
        simulated = self.simulate is not None
        for name in self.only(not simulated):
            if name == "distance" and self.psf_folder is not None:
                continue
            if name in self.model_fields_set:
                where = "frames" if simulated else "--simulate"
                raise OptionError(f"{self.flag(name)} goes with {where} only: leave it out")
        if not simulated:
            self.check_frames()

    @property
    def psf_folder(self) -> Path | None:
        """The camera's folder, where `psf` is its list of PSFs."""
        return self.psf.parent if self.psf is not None and self.psf.name == PSFS_FILE else None

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return _SIMULATED_ONLY if simulated else _FRAMES_ONLY

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If a picture is no linear one, or the angle of a pixel is given twice or not at all.
        """
        if self.psf is None:
            for name, value in (
                ("psf-extent", self.psf_extent != "auto"),
                ("dark", self.dark),
                ("iterations", self.iterations),
                ("tau", self.tau),
            ):
                if value:
                    raise OptionError(
                        f"--{name} goes with raw frames, which --psf reconstructs: give --psf too, "
                        f"or leave --{name} out"
                    )
            for path in self.frames:
                if path.suffix.lower() not in _LINEAR:
                    raise OptionError(
                        f"{path} is no linear picture: without --psf, give pictures that nolens "
                        f"reconstruct wrote as {_LINEAR[0]}; with --psf, raw frames"
                    )
            if self.support is not None and self.pixel_angle is not None:
                raise OptionError(
                    f"--support {self.support} says where on the sensor the pictures lie, which "
                    f"matters with --camera only: leave it out, or --pixel-angle {self.pixel_angle}"
                )
        if self.camera is not None and self.pixel_angle is not None:
            raise OptionError(
                f"--camera {self.camera} and --pixel-angle {self.pixel_angle} both say how large "
                "a pixel is: leave one out"
            )

    @property
    def settings(self) -> SolverSettings:
        """How pictures are taken and solved."""
        iterations = self.iterations or self.default_iterations
        return SolverSettings(iterations, self.tau or TAU, self.fill.value, self.seed)


class OneFrameOptions(ResolutionOptions):
    """What the measurement of one picture can be told."""

    def check_frames(self) -> None:
        """Refuse options for frames that do not go together.

        Raises
        ------
        OptionError
            If there are more frames than one.
        """
        super().check_frames()
        if len(self.frames) > 1:
            raise OptionError(
                f"{len(self.frames)} frames are given: one picture of the target is measured at a "
                "time"
            )

    @classmethod
    def only(cls, simulated: bool) -> tuple[str, ...]:
        """Options that only simulations take, or only frames."""
        return (*super().only(simulated), *(("distance",) if simulated else ()))


@dataclass(frozen=True)
class TargetPicture:
    """One picture of a target.

    Parameters
    ----------
    picture
        Mean of its channels, (height, width).
    scale
        Angles of its pixels.
    """

    picture: Tensor
    scale: AngularScale


def target_pictures(run: Run[Options]) -> list[TargetPicture]:
    """Every frame of a run as a picture: read, or reconstructed with the PSF.

    Every file is read and checked before the first one is reconstructed.

    Raises
    ------
    NolensError
        If a file cannot be used.
    """
    options, camera = run.options, _camera(run)
    if options.psf is None:
        return [_read(path, options, camera) for path in options.frames]
    folder = options.psf_folder
    psfs = None if folder is None else read_psfs(run, folder, options.distance)
    development = Development(
        read_frame(options.psf) if psfs is None else psfs.ahead,
        None if options.dark is None else read_frame(options.dark),
        channels="grey",
        field_points=() if psfs is None else psfs.field_points,
    )
    field_psf: FieldPsf | None = None
    solvable: list[tuple[Measurement, Tensor, PixelRectangle, AngularScale]] = []
    for path in options.frames:
        frame = read_frame(path)
        if not solvable:
            choice = choose_psf(development, frame, PsfSettings(extent=options.psf_extent))
            development = choice.development
            run.warn(*choice.notes)
        measurement = development.measurement(frame)
        prepared = development.prepared(measurement)
        if not solvable:
            run.warn(*prepared.notes, *prepared.warnings)
            field_psf = development.field_psf(measurement)
        support = PixelRectangle(0, 0, *measurement.size)
        if options.support is not None:
            support = parse_window(options.support, measurement.size, "--support")
        scale = _scale(path, options, camera, support)
        solvable.append((measurement, prepared.values, support, scale))
    run.begin()
    pictures = []
    for number, (measurement, psf, support, scale) in enumerate(solvable):
        picture = solved(
            measurement,
            psf,
            support,
            iterations=options.settings.iterations,
            tau=options.settings.tau,
            field_psf=field_psf,
            progress=part_of(partial(run.reporter.advance, "frames"), number, len(solvable)),
        )[0]
        pictures.append(TargetPicture(picture, scale))
    return pictures


def _camera(run: Run[Options]) -> LoadedCamera | None:
    """The camera that is named, or the one beside the PSF; None where a pixel's angle is given."""
    options = run.options
    if options.pixel_angle is not None:
        return None
    folder = None if options.psf is None else options.psf.parent
    camera = run.camera_beside(options.camera, folder)
    if camera is None:
        raise OptionError(
            "nothing says under which angle a pixel is seen: give the camera that took the "
            "frames (--camera FOLDER), or the angle (--pixel-angle 0.138deg)"
        )
    return camera


def _read(path: Path, options: ResolutionOptions, camera: LoadedCamera | None) -> TargetPicture:
    """A picture that was reconstructed already."""
    frame = read_frame(path)
    if frame.mosaic is not None:
        raise DataError(
            f"{path} holds raw counts behind a colour mosaic: give --psf to reconstruct it, or a "
            "picture that nolens reconstruct wrote"
        )
    picture = develop(frame, channels="grey").values[0]
    height, width = picture.shape
    support = PixelRectangle(0, 0, height, width)
    if camera is not None:
        sensor = preview_model(camera).shape
        support = PixelRectangle.centred(height, width, sensor)
        if options.support is not None:
            support = parse_window(options.support, sensor, "--support")
        if (support.height, support.width) != (height, width):
            raise OptionError(
                f"--support {options.support} is {support.height}×{support.width} pixels, but "
                f"{path} shows {height}×{width}: give the support that it was reconstructed with"
            )
    return TargetPicture(picture, _scale(path, options, camera, support))


def _scale(
    path: Path, options: ResolutionOptions, camera: LoadedCamera | None, support: PixelRectangle
) -> AngularScale:
    """Angles of the pixels of a support."""
    if options.pixel_angle is not None:
        return AngularScale(math.tan(options.pixel_angle.rad))
    assert camera is not None
    twin = preview_model(camera)
    rows, columns = twin.shape
    if support.height > 2 * rows or support.width > 2 * columns:
        raise DataError(
            f"{path} shows {support.height}×{support.width} pixels, but the sensor of "
            f"{camera.camera.name!r} has {rows}×{columns}: give the camera that took it"
        )
    return AngularScale.of_camera(twin, support)


def measure_simulated(
    run: Run[Options], target_at: Callable[[float], SimulatedTarget[Value]], what: str
) -> Value:
    """What the run's simulated camera shows of a target.

    Parameters
    ----------
    run
        Which camera.
    target_at
        The target at a distance in µm.
    what
        Its name, for who watches.

    Raises
    ------
    NolensError
        If the camera, the light or the distance cannot be used, the machine has too little memory,
        or a file of the camera would be written over.
    """
    options = run.options
    assert options.simulate is not None
    loaded = run.camera(options.simulate)
    target = target_at(distance_um(options.distance, loaded))
    preview = VirtualExperiment(preview_model(loaded), Light(options.light), options.wavelengths)
    twin = run.twin(loaded, target.working_bytes(preview), _REMEDY)
    progress = partial(run.reporter.advance, what)
    return target.measure(replace(preview, twin=twin), options.settings, progress)


def target_picture(
    run: Run[Options], drawing: Callable[[int], Tensor], angle_deg: float, what: str
) -> FlatPicture:
    """The only frame as a flat screen has it, or the picture of a simulated camera.

    Parameters
    ----------
    run
        Which frame, or which camera.
    drawing
        What a simulated camera is shown: gives a square, (side, side) from 0 to 1, for a side in
        pixels.
    angle_deg
        Field angle that the side of the square fills.
    what
        Name of the target, for who watches.

    Raises
    ------
    NolensError
        If a file or an option cannot be used, or the angle is beyond the model.
    """
    if run.options.simulate is None:
        (each,) = target_pictures(run)
        return each.scale.flat(each.picture)
    return measure_simulated(run, partial(ScreenTarget, drawing, angle_deg), what)


def resolution_product(
    run: Run[Options],
    target: str,
    value: Value,
    figures: Mapping[str, Any],
    draw: Callable[[Value, Path], None],
) -> Product[Value]:
    """The figures, how their pictures were solved, and the plot if it is asked for.

    Parameters
    ----------
    run
        What was asked for.
    target
        Its name.
    value
        What was measured.
    figures
        Of it, in values that JSON has, of any number of digits.
    draw
        Draws it, as the PNG of a path.
    """
    options = run.options
    reconstructs = options.simulate is not None or options.psf is not None
    solver = {
        "simulated": options.simulate,
        "iterations": options.settings.iterations if reconstructs else None,
        "tau": options.settings.tau if reconstructs else None,
    }
    writers = {} if options.plot is None else {options.plot: partial(draw, value)}
    return Product(value, {"target": target, **rounded(figures, _DIGITS), **solver}, writers)


def solver_line(summary: Mapping[str, Any]) -> list[str]:
    """How the pictures were solved, for a terminal; nothing where they were pictures already."""
    if summary["iterations"] is None:
        return []
    return [f"reconstructed with {summary['iterations']} iterations, tau {summary['tau']:g}"]


class ScreenPicture(JobOptions):
    """A target in black and white, to show on a screen.

    Its fields are options of `nolens measure target`, each with a default; a name that a target
    before it has means the same.

    Attributes
    ----------
    about
        What it shows.
    """

    about: ClassVar[str]

    @abstractmethod
    def draw(self, side: int) -> Tensor:
        """Give it, (side, side) from 0 to 1, for a side in pixels."""


@dataclass(frozen=True)
class ResolutionTarget:
    """What can be put in front of a camera to measure how fine it resolves.

    Parameters
    ----------
    job
        Measures; the docstring of its options is the help of its command.
    lines
        Text of the summary for a terminal.
    picture
        The target as `nolens measure target` draws it; None where no screen can show it.
    """

    job: Job[Any, Any]
    lines: Callable[[dict[str, Any]], Iterable[str]]
    picture: type[ScreenPicture] | None = None


_HERE = "nolens.jobs.measuring"
TARGETS = Registry[ResolutionTarget](
    "nolens.targets",
    {
        "two-points": f"{_HERE}.two_points:TWO_POINTS",
        "siemens": f"{_HERE}.siemens:SIEMENS",
        "edge": f"{_HERE}.edge:EDGE",
    },
    "resolution target",
    "ResolutionTarget",
    lambda each: isinstance(each, ResolutionTarget),
)


def screen_pictures() -> dict[str, type[ScreenPicture]]:
    """Pictures of the targets that have one, by name, but for packages that cannot be loaded."""
    pictures = {}
    for name in TARGETS.names:
        with suppress(OptionError):
            target = TARGETS.load(name)
            if target.picture is not None:
                pictures[name] = target.picture
    return pictures
