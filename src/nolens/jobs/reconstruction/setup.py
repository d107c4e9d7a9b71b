"""What the first frame of a camera decides: how files are read, and what is solved."""

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from nolens.camera import FieldPsf, Frame, Measurement, PsfGeometry, black_level, flipped
from nolens.camera.psf_set import Depth, depth_um
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.files.weights import trained_prior
from nolens.jobs.reconstruction.acceptance import acceptance_of, camera_of
from nolens.jobs.reconstruction.options import (
    LESS_MEMORY,
    ReconstructOptions,
    parse_support,
    parse_window,
)
from nolens.jobs.run import Run, announce_memory, check_solver_memory, mapped_where_needed
from nolens.operators import Geometry, PixelRectangle
from nolens.solvers import (
    Developed,
    Development,
    FieldPoint,
    Method,
    Prior,
    Problem,
    PsfChoice,
    PsfSettings,
    Quality,
    Reconstructor,
    SupportChoice,
    Weight,
    choose_psf,
    geometry_row,
    stop_of,
)
from nolens.solvers.admm_state import Balance
from nolens.solvers.explanation import FieldChoice, SupportBy, choose_field, explain
from nolens.solvers.held_out import Prediction
from nolens.solvers.inputs import support_of, tensor_of
from nolens.solvers.reconstructor import SPARE
from nolens.solvers.result import window_of
from nolens.solvers.scene_prior import SLOW_PRIOR

if TYPE_CHECKING:
    from nolens.files.psf_folder import ScenePsfs
    from nolens.twin import Rectification, Twin

_RESUMED = 1e-4
"""A weight that stands for the one of a state, until that is read."""


@dataclass(frozen=True)
class Prepared:
    """What the first measurement decides before a problem is built.

    `options` have the binning that was chosen, `development` has it too. `psf` is how its file
    is read, `light` the choice of the support, where it was the program's, and `field` that of PSFs
    over the field.
    """

    options: ReconstructOptions
    psf: PsfChoice
    development: Development
    measurement: Measurement
    reconstructor: Reconstructor
    light: SupportChoice | None
    field: FieldChoice

    @classmethod
    def of(
        cls,
        run: Run[ReconstructOptions],
        development: Development,
        frame: Frame,
        chosen: Mapping[str, Any] | None = None,
    ) -> "Prepared":
        """Develop measurement and PSF; the weight of the prior is not chosen."""
        if chosen is None:
            choice, options = _psf_choice(run, development, frame), run.options
        else:
            choice = PsfChoice(_as_chosen(development, chosen))
            update = {name: chosen[name] for name in ("bin", "tau", "prior") if name in chosen}
            update["detail"] = 1.0
            options = run.options.model_copy(update=update)
        options, developed = _developed(run, options, choice.development, frame)
        psf = developed.prepared.values
        support = _support(options, developed.measurement.size, psf)
        for text in developed.prepared.notes:
            run.reporter.note(text)
        run.warn(*developed.prepared.warnings)
        measurement, development = developed.measurement, developed.development
        field_psf = development.field_psf(measurement)
        reconstructor = _reconstructor(options, psf, support, run.device, field_psf)
        light = _light(run, reconstructor, options, measurement, psf)
        if light is not None:
            reconstructor = replace(reconstructor, support=light.support)
        field = FieldChoice(reconstructor)
        if options.field_points == "auto":
            field = choose_field(reconstructor, measurement, development.psf_alone(measurement))
        run.warn(*field.warnings)
        solver = field.reconstructor
        run.warn(*_coverage_warnings(options, solver, measurement, development, light))
        return cls(options, choice, development, measurement, solver, light, field)

    @property
    def support_by(self) -> SupportBy:
        """What tells the support."""
        if self.options.support != "auto" or self.options.field is not None:
            return "person"
        return "camera" if self.light is not None and self.light.is_acceptance else "measurement"


@dataclass(frozen=True)
class Setup(Prepared):
    """What the first measurement decides for all of a run.

    `weight` is the choice of τ, where it was the program's. `window` (top, left, height, width) is
    the part of the scene that is written.
    """

    weight: Weight | None
    prediction: Prediction | None
    problem: Problem
    window: tuple[int, int, int, int]
    twin: "Twin | None" = None
    """The camera's layers, where shading or distortion is undone."""

    @classmethod
    def of(
        cls,
        run: Run[ReconstructOptions],
        development: Development,
        frame: Frame,
        chosen: Mapping[str, Any] | None = None,
    ) -> "Setup":
        """Develop measurement and PSF, and build the problem.

        `chosen` are the `choices` of a run before, in place of new ones.
        """
        twin = _twin(run)
        prepared = Prepared.of(run, development, frame, chosen)
        options, development = prepared.options, prepared.development
        measurement = prepared.measurement
        reconstructor = _prior_by_size(
            prepared.reconstructor, options, measurement, run.reporter.note
        )
        if twin is not None:
            _check_pixels(twin, options, measurement)
        psf = tensor_of(reconstructor.psf, "PSF")
        reconstructor = mapped_where_needed(
            reconstructor, measurement, LESS_MEMORY, run.reporter.note
        )
        announce_memory(check_solver_memory(reconstructor, measurement, LESS_MEMORY), run.reporter)
        weight = _weight(run, reconstructor, options, measurement)
        if weight is not None:
            reconstructor = reconstructor.with_detail(weight, options.detail)
        prediction = None
        if chosen is None:
            explanation = explain(
                reconstructor,
                measurement,
                weight,
                development.psf.source,
                support_by=prepared.support_by,
            )
            run.warn(*explanation.warnings)
            prediction = explanation.prediction
        problem = reconstructor.problem(measurement)
        if chosen is None and options.prior_note is not None:
            run.reporter.note(options.prior_note)
        return cls(
            options,
            prepared.psf,
            replace(development, field_points=()),
            measurement,
            reconstructor,
            prepared.light,
            prepared.field,
            weight,
            prediction,
            problem,
            _crop_window(options, problem, psf),
            twin,
        )

    def varied(
        self, run: Run[ReconstructOptions], options: ReconstructOptions, psf: Tensor
    ) -> "Setup":
        """The same measurement and PSF with other options of the model and the solver.

        Another support, weight or detail keeps what was chosen else; another method or prior has a
        weight of its own.
        """
        own, reconstructor, weight = self.options, self.reconstructor, self.weight
        if options.support != own.support:
            support = _support(options, self.measurement.size, psf)
            reconstructor = replace(reconstructor, support=support)
        elif (options.method, options.prior) == (own.method, own.prior):
            if options.tau != "auto":
                reconstructor = replace(reconstructor, tau=options.tau)
            elif weight is not None:
                reconstructor = reconstructor.with_detail(weight, options.detail)
        else:
            support, field_psf = self.problem.forward.support, reconstructor.field_psf
            reconstructor = _reconstructor(options, psf, support, run.device, field_psf)
            reconstructor = _prior_by_size(reconstructor, options, self.measurement)
            weight = _weight(run, reconstructor, options, self.measurement)
            if weight is not None:
                reconstructor = reconstructor.with_detail(weight, options.detail)
        problem = reconstructor.problem(self.measurement)
        return replace(
            self,
            options=options,
            reconstructor=reconstructor,
            weight=weight,
            problem=problem,
            window=_crop_window(options, problem, psf),
        )

    @property
    def choices(self) -> dict[str, Any]:
        """What was chosen by this measurement, in values that JSON has."""
        development = self.development
        return {
            "bin": development.bin_by,
            "tau": self.tau,
            "prior": str(self.prior),
            "black": development.black,
            "psf_black": list(development.psf.black),
            "psf_black_stated": development.psf.black_stated,
            "psf": asdict(development.psf_geometry),
        }

    @property
    def window_on_sensor(self) -> list[int]:
        """`window` with its top and left counted in the sensor's frame."""
        top, left, *size = self.window
        origin = self.problem.forward.geometry.origin
        return [top + origin[0], left + origin[1], *size]

    @property
    def support(self) -> str:
        """As --support takes it."""
        support = self.problem.forward.support
        return "full" if support is None else support.text

    @property
    def tau(self) -> float:
        """The weight of the prior: that of the options, or the program's choice."""
        return self.problem.weight if self.options.tau == "auto" else self.options.tau

    @property
    def prior(self) -> str | Path:
        """As --prior takes it; auto for total variation that was the program's choice."""
        trained = self.reconstructor.network is not None
        return self.options.photo_prior if trained else self.options.prior

    @property
    def prior_facts(self) -> dict[str, str]:
        """What a record says of the prior: its name, and which weights it has."""
        return self.reconstructor.prior_facts or {"prior": self.problem.prior.value}

    @property
    def pixel_rad(self) -> float | None:
        """Angle of a scene pixel in the middle of the view; None where no camera is known."""
        options = self.options
        size = self.measurement.size
        loaded = camera_of(options.camera, options.psf.parent, options.bin_by, size)
        if loaded is None:
            return None
        # Most reconstructions need no camera.
        from nolens.calibrate.distances import pixel_angle

        sensor = loaded.camera.sensor
        pitch_um = self.options.bin_by * sensor.superpixel * sensor.pitch.um
        return pixel_angle(loaded.camera, pitch_um)

    def picture(self, scene: Tensor) -> Tensor:
        """The part of a scene that is written, rectified and turned as the options say."""
        picture = window_of(scene, self.window).cpu()
        rectification = self.rectification
        if rectification is not None and self.options.flatten:
            picture = rectification.flattened(picture)
        if rectification is not None and self.options.undistort:
            picture = rectification.undistorted(picture)
        return flipped(picture, self.options.flip)

    @property
    def rectification(self) -> "Rectification | None":
        """What undoes shading and distortion; None where neither is asked for."""
        if self.twin is None:
            return None
        # Most reconstructions need no camera.
        from nolens.twin import Rectification

        window = PixelRectangle(*self.window_on_sensor)
        return Rectification(self.twin, window, self.options.bin_by)


def _twin(run: Run[ReconstructOptions]) -> "Twin | None":
    """The camera's layers for --flatten and --undistort.

    Raises
    ------
    NolensError
        If no camera is known, or its description is bad.
    """
    options = run.options
    if not (options.flatten or options.undistort):
        return None
    loaded = run.camera_beside(options.camera, options.psf.parent)
    if loaded is None:
        raise OptionError(
            f"--{'flatten' if options.flatten else 'undistort'} follows rays through the camera's "
            f"layers, and {options.psf} does not say what they are: give --camera, or a camera's "
            f"folder with {CAMERA_FILE} as --psf"
        )
    # Most reconstructions need no camera.
    from nolens.twin import preview_model

    return preview_model(loaded)


def _check_pixels(twin: "Twin", options: ReconstructOptions, measurement: Measurement) -> None:
    size = tuple(count // options.bin_by for count in twin.shape)
    if size != measurement.size:
        raise OptionError(
            f"the measurement has {measurement.size[0]}×{measurement.size[1]} pixels, and the "
            f"camera {twin.camera.name!r} would give {size[0]}×{size[1]}: for --flatten and "
            "--undistort give the camera that it is from (--camera)"
        )


def _coverage_warnings(
    options: ReconstructOptions,
    reconstructor: Reconstructor,
    measurement: Measurement,
    development: Development,
    light: SupportChoice | None,
) -> list[str]:
    """About angles of the scene that PSFs over the field do not cover.

    Raises
    ------
    OptionError
        If the options ask for such a scene.
    """
    field_psf = reconstructor.field_psf
    if options.psf_folder is None or field_psf is None:
        return []
    # Most reconstructions need no camera.
    from nolens.files.psf_folder import PsfFolder

    known = light is None or not light.is_acceptance
    scene = support_of(reconstructor.support, measurement.size) if known else None
    stated = stated_options(
        support=options.support, field=options.field, field_points=options.field_points
    )
    folder = PsfFolder(options.psf_folder)
    return folder.coverage_warnings(field_psf, scene, measurement.size, development.merged, stated)


def stated_options(**values: object) -> str:
    """Options that state a scene or PSFs, as the command line has them; empty without any."""
    return " and ".join(
        f"--{name.replace('_', '-')} {value}"
        for name, value in values.items()
        if value not in (None, "auto", "full")
    )


def _psf_choice(run: Run[ReconstructOptions], development: Development, frame: Frame) -> PsfChoice:
    """How the PSF's file is read, as the options say or the measurement shows."""
    options = run.options
    settings = PsfSettings(options.psf_scale, options.psf_extent, options.psf_flip)
    choice = choose_psf(development, frame, settings)
    for text in choice.notes:
        run.reporter.note(text)
    return choice


def _as_chosen(development: Development, chosen: Mapping[str, Any]) -> Development:
    """How frames are developed after `Setup.choices`."""
    psf = replace(
        development.psf,
        black=tuple(chosen["psf_black"]),
        black_stated=chosen["psf_black_stated"],
    )
    return replace(
        development,
        psf=psf,
        black=chosen["black"],
        bin_by=chosen["bin"],
        psf_geometry=PsfGeometry(**chosen["psf"]),
    )


def psf_row(choice: PsfChoice) -> dict[str, Any]:
    """How the PSF's file was read, for the record."""
    development = choice.development
    return {
        **geometry_row(development.psf_geometry),
        "black": list(development.psf.black),
        "trials": [each.row() for each in choice.trials],
    }


def _weight(
    run: Run[ReconstructOptions],
    reconstructor: Reconstructor,
    options: ReconstructOptions,
    measurement: Measurement,
) -> Weight | None:
    """The choice of τ, where the options leave it to the program."""
    if options.tau != "auto":
        return None
    if options.resume is not None:
        return Weight(_RESUMED, 0.0)

    def watch(fraction: float) -> bool:
        return run.reporter.step(
            "% of the choice of tau", round(100 * fraction), 100, "the picture"
        )

    return reconstructor.choose_weight(measurement, progress=watch)


def _light(
    run: Run[ReconstructOptions],
    reconstructor: Reconstructor,
    options: ReconstructOptions,
    measurement: Measurement,
    psf: Tensor,
) -> SupportChoice | None:
    """The choice of the support, where the options leave it to the program.

    Light of later frames of a sequence can come from elsewhere than that of the first: their
    support is the camera's acceptance.
    """
    if options.support != "auto" or options.field is not None:
        return None
    by, size = options.bin_by, measurement.size
    loaded = camera_of(options.camera, options.psf.parent, by, size)
    acceptance = None
    if loaded is not None:
        nearest_um = None if options.distance is None else depth_um(options.distance)
        acceptance = acceptance_of(loaded, by, size, psf, nearest_um)
        if options.camera is None:
            run.reads({"layers of the camera": options.psf.parent / CAMERA_FILE})
    if options.is_sequence:
        return None if acceptance is None else reconstructor.accept(measurement, acceptance)

    def watch(fraction: float) -> bool:
        return run.reporter.step(
            "% of the choice of the support", round(100 * fraction), 100, "the picture"
        )

    return reconstructor.choose_support(measurement, progress=watch, acceptance=acceptance)


def _read_psf(
    run: Run[ReconstructOptions],
) -> tuple[Frame, tuple[FieldPoint, ...], Frame | None]:
    """The PSF, those over the field that a folder has, and the one in their place."""
    options = run.options
    if options.psf_folder is not None:
        most = None if options.field_points == "auto" else options.field_points
        psfs = read_psfs(run, options.psf_folder, options.distance, most)
        return psfs.ahead, psfs.field_points, psfs.alone
    psf = run.frame("psf")
    # Like the measurement as far as its channels allow: it may be grey.
    if len(psf.channels) == 3 and options.bgr:
        psf = run.frame("psf", bgr=True)
    elif len(psf.channels) != 3 and options.mosaic is not None and psf.mosaic is None:
        psf = run.frame("psf", mosaic=options.mosaic)
    return psf, (), None


def read_psfs(
    run: Run[Any], path: Path, distance: Depth | None, most: int | None = None
) -> "ScenePsfs":
    """The PSF of a folder straight ahead, and those over the field (`PsfFolder.for_scene`)."""
    # Most reconstructions need no camera.
    from nolens.files.psf_folder import PsfFolder

    folder = PsfFolder(path)
    psfs = folder.for_scene(None if distance is None else depth_um(distance), most)
    run.reads({f"PSF {each.file}": path / each.file for each in psfs.entries})
    if psfs.field_points:
        run.reads({"layers of the camera": path / CAMERA_FILE})
    if psfs.note:
        run.reporter.note(psfs.note)
    return psfs


def read_development(run: Run[ReconstructOptions]) -> Development:
    """Read all but the measurement."""
    options = run.options
    psf, field_points, alone = _read_psf(run)
    dark, flat = (
        run.frame(name, mosaic=options.mosaic, bgr=options.bgr) if getattr(options, name) else None
        for name in ("dark", "flat")
    )
    return Development(
        psf,
        dark,
        flat,
        black_level(options.black, psf),
        options.white,
        options.bin_by,
        options.channels,
        field_points=field_points,
        alone=alone,
    )


def _developed(
    run: Run[ReconstructOptions],
    options: ReconstructOptions,
    development: Development,
    frame: Frame,
) -> tuple[ReconstructOptions, Developed]:
    """A frame and the PSF, on pixels no finer than the PSF carries, unless --bin says otherwise.

    Also the options, with the binning that was chosen.
    """
    if options.bin is not None:
        measurement = development.measurement(frame)
        return options, Developed(development, measurement, development.prepared(measurement), ())
    # Parts of the scene are in pixels, and would be others.
    coarsen = options.support in ("auto", "full") and options.crop in (None, "all")
    result = development.fitted(frame, SPARE[method_of(options)], coarsen=coarsen)
    for text in result.notes:
        run.reporter.note(text)
    if result.development.bin_by > 1:
        options = options.model_copy(update={"bin": result.development.bin_by})
    return options, result


def method_of(options: ReconstructOptions) -> Method:
    """The solver: what --quality or --method say; an error if they contradict each other."""
    if options.quality is None:
        return options.method
    if options.method is not Method.ADMM:
        raise OptionError(
            f"--quality {options.quality} chooses how to solve, and so does --method "
            f"{options.method}: leave one out"
        )
    return Method.WIENER if options.quality is Quality.DRAFT else Method.ADMM


def _reconstructor(
    options: ReconstructOptions,
    psf: Tensor,
    support: PixelRectangle | None,
    device: torch.device,
    field_psf: FieldPsf | None,
) -> Reconstructor:
    """The solver with the preset's limits, or the options' in their place."""
    method = method_of(options)
    return Reconstructor(
        psf,
        support,
        tau=None if options.tau == "auto" else options.tau,
        prior=trained_prior(options.photo_prior),
        method=method,
        stop=stop_of(
            method,
            options.quality,
            iterations=options.iterations,
            tolerance=options.tolerance,
            low_frequency=options.low_frequency,
        ),
        penalties=options.penalties,
        balance=Balance() if options.balance else None,
        relaxation=options.relaxation,
        device=device,
        field_psf=field_psf,
    )


def _prior_by_size(
    reconstructor: Reconstructor,
    options: ReconstructOptions,
    measurement: Measurement,
    note: Callable[[str], None] = lambda _: None,
) -> Reconstructor:
    """By total variation, where a trained prior was the program's choice and takes minutes."""
    stated = options.prior != Prior.AUTO
    if stated or not reconstructor.takes_minutes(len(measurement.channels), measurement.size):
        return reconstructor
    note(SLOW_PRIOR)
    return replace(reconstructor, prior=Prior.AUTO)


def _support(
    options: ReconstructOptions, sensor: tuple[int, int], psf: Tensor
) -> PixelRectangle | None:
    """Pixels that light can come from: --support, or --field through the --camera.

    None for all, and where the program is to choose them.
    """
    if options.support not in ("auto", "full") and options.field is not None:
        raise OptionError(
            f"--support {options.support} and --field {options.field} both say where light can "
            "come from: leave one out"
        )
    if options.field is not None and options.camera is None:
        raise OptionError(
            "--field needs --camera: an angle becomes pixels by the camera's layers. Give both, "
            "such as --field 56deg --camera paper"
        )
    unlimited = options.support in ("auto", "full")
    support = None if unlimited else parse_support(options.support, sensor, psf)
    rectified = options.flatten or options.undistort
    if options.camera is None or (options.field is None and rectified):
        return support
    # Most reconstructions need no camera.
    from nolens.files import read_camera
    from nolens.twin import FieldMap, preview_model

    camera = preview_model(read_camera(options.camera))
    size = tuple(count // options.bin_by for count in camera.shape)
    if size != sensor:
        raise OptionError(
            f"the camera {options.camera} has {size[0]}×{size[1]} pixels (height × width), and "
            f"the measurement {sensor[0]}×{sensor[1]}: give the measurement's camera, or --support"
        )
    if options.field is None:
        return support
    tangent = math.tan(math.radians(options.field.deg) / 2)
    whole = FieldMap.covering(camera, (tangent, tangent)).support
    by = options.bin_by
    side = -(-whole.height // by), -(-whole.width // by)
    return parse_support(f"{side[0]}x{side[1]}", sensor, psf)


def _crop_window(
    options: ReconstructOptions, problem: Problem, psf: Tensor
) -> tuple[int, int, int, int]:
    """Part of the scene that is written, (top, left, height, width).

    A support that was chosen gives the picture that none would give, dark around it.
    """
    chosen = options.support == "auto" and options.field is None
    if options.crop is None:
        return problem.sensor_frame if chosen else problem.frame
    sensor, geometry = problem.forward.sensor, problem.forward.geometry
    seen = geometry
    if chosen:
        seen = Geometry.build(sensor, (psf.shape[-2], psf.shape[-1]), None)
    whole = PixelRectangle(*seen.origin, *seen.scene[2:])
    crop = whole if options.crop == "all" else parse_window(options.crop, sensor, "--crop")
    if crop.union(whole) != whole:
        raise OptionError(
            f"--crop {options.crop} reaches beyond the scene, which is {whole.height}×"
            f"{whole.width} pixels from {whole.top:+d}{whole.left:+d}; give a part of that, or all"
        )
    top, left = geometry.origin
    return crop.top - top, crop.left - left, crop.height, crop.width
