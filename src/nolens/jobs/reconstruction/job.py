"""From a measurement, or a sequence of them, and a PSF on disk to pictures on disk."""

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.camera import (
    Frame,
    Measurement,
    arrange_rgb,
    black_level,
    exposure_white,
    flipped,
)
from nolens.errors import DataError, FileError, NolensError, OptionError
from nolens.files import (
    CAMERA_FILE,
    InputFile,
    open_sequence,
    read_frame,
    read_state,
    readable,
    write_into,
    write_png,
    write_state,
    write_tiff16,
    write_tiff32,
)
from nolens.jobs.reconstruction.options import (
    LESS_MEMORY,
    ReconstructOptions,
    parse_support,
    parse_window,
)
from nolens.jobs.reconstruction.sweep import (
    SweptPicture,
    sweep_settings,
    sweep_writers,
    swept_options,
)
from nolens.jobs.run import Product, Run, Writer, announce_memory, check_solver_memory, job
from nolens.operators import Geometry, PixelRectangle
from nolens.solvers import (
    AdmmState,
    Developed,
    Development,
    Method,
    Problem,
    Progress,
    PsfChoice,
    PsfSettings,
    Quality,
    Reconstructor,
    Stop,
    Stream,
    SupportChoice,
    Weight,
    choose_psf,
    geometry_row,
    stop_of,
)
from nolens.solvers.admm_state import Balance
from nolens.solvers.explanation import explain, picture_warnings
from nolens.solvers.held_out import Prediction
from nolens.solvers.inputs import tensor_of
from nolens.solvers.reconstructor import SPARE
from nolens.solvers.report import Report
from nolens.solvers.result import window_of
from nolens.solvers.stream import CHECK_WEIGHT_EVERY, FOLLOWING, weight_to_follow

_RESUMED = 1e-4
"""A weight that stands for the one of a state, until that is read."""
_DROPS_REPORTED = 5
"""Frames that are dropped with a warning each; of more, the record has all."""
_PROBLEM_OPTIONS = (
    "black",
    "white",
    "mosaic",
    "bgr",
    "detail",
    "prior",
    "bin",
    "channels",
    "support",
    "field",
    "camera",
)
"""Options that decide what problem is solved; how long and where may change."""


@job
def reconstruct(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Radiance of the part that was written, (channels, height, width); a sequence's last one.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    if run.options.is_sequence:
        return _reconstruct_sequence(run)
    if run.options.latency is not None:
        raise OptionError(
            f"--latency {run.options.latency} bounds the frames of a sequence, and "
            f"{run.options.measurement} is one frame: leave it out, or give a folder or a stack of "
            "frames"
        )
    _method(run.options)  # A contradiction is an error before anything is read.
    development = _read_development(run.options)
    frame = read_frame(run.options.measurement, mosaic=run.options.mosaic, bgr=run.options.bgr)
    return _reconstruct_frame(run, _Setup.of(run, development, frame))


@dataclass(frozen=True)
class _Setup:
    """What the first measurement decides for all of a run.

    `options` have the binning that was chosen, `development` has it too. `psf` is how its file
    is read. `weight` is the choice of τ, where it was the program's, `light` that of the support.
    `window` (top, left, height, width) is the part of the scene that is written.
    """

    options: ReconstructOptions
    psf: PsfChoice
    development: Development
    measurement: Measurement
    reconstructor: Reconstructor
    weight: Weight | None
    prediction: Prediction | None
    light: SupportChoice | None
    problem: Problem
    window: tuple[int, int, int, int]

    @classmethod
    def of(cls, run: Run[ReconstructOptions], development: Development, frame: Frame) -> "_Setup":
        """Develop measurement and PSF, and build the problem."""
        choice = _psf_choice(run, development, frame)
        options, developed = _developed(run, choice.development, frame)
        psf = developed.prepared.values
        support = _support(options, developed.measurement.size, psf)
        for text in developed.prepared.notes:
            run.reporter.note(text)
        run.warn(*developed.prepared.warnings)
        reconstructor = _reconstructor(options, psf, support, run.device)
        measurement, development = developed.measurement, developed.development
        light = _light(run, reconstructor, options, measurement)
        if light is not None:
            reconstructor = replace(reconstructor, support=light.support)
        needed = check_solver_memory(reconstructor, measurement, LESS_MEMORY)
        announce_memory(needed, run.reporter)
        weight = _weight(run, reconstructor, options, measurement)
        if weight is not None:
            reconstructor = replace(reconstructor, tau=weight.tau / options.detail)
        explanation = explain(reconstructor, measurement, weight, development.psf.source)
        run.warn(*explanation.warnings)
        problem = reconstructor.problem(measurement)
        window = _crop_window(options, problem, psf)
        return cls(
            options,
            choice,
            development,
            measurement,
            reconstructor,
            weight,
            explanation.prediction,
            light,
            problem,
            window,
        )

    def varied(
        self, run: Run[ReconstructOptions], options: ReconstructOptions, psf: Tensor
    ) -> "_Setup":
        """The same measurement and PSF with other options of the model and the solver."""
        support = self.problem.forward.support
        if options.support != self.options.support:
            support = _support(options, self.measurement.size, psf)
        reconstructor = _reconstructor(options, psf, support, run.device)
        weight = _weight(run, reconstructor, options, self.measurement)
        if weight is not None:
            reconstructor = replace(reconstructor, tau=weight.tau / options.detail)
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
    def pixel_rad(self) -> float | None:
        """Angle of a scene pixel in the middle of the view; None where no camera is known."""
        options = self.options
        camera = options.camera or options.psf.parent / CAMERA_FILE
        if isinstance(camera, Path) and not camera.is_file():
            return None
        # Most reconstructions need no camera.
        from nolens.calibrate.distances import pixel_angle
        from nolens.files import read_camera

        try:
            described = read_camera(camera).camera
        except NolensError:  # A file beside the PSF may be of another kind.
            return None
        side = options.bin_by * (1 if described.sensor.mosaic == "none" else 2)
        size = described.sensor.rows // side, described.sensor.columns // side
        if size != self.measurement.size:  # Another camera's.
            return None
        return pixel_angle(described, side * described.sensor.pitch.um)

    def picture(self, scene: Tensor) -> Tensor:
        """The part of a scene that is written, as --flip turns it."""
        return flipped(window_of(scene, self.window).cpu(), self.options.flip)


def _psf_choice(run: Run[ReconstructOptions], development: Development, frame: Frame) -> PsfChoice:
    """How the PSF's file is read, as the options say or the measurement shows."""
    options = run.options
    settings = PsfSettings(options.psf_scale, options.psf_extent, options.psf_flip)
    choice = choose_psf(development, frame, settings)
    for text in choice.notes:
        run.reporter.note(text)
    return choice


def _psf_row(choice: PsfChoice) -> dict[str, Any]:
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
) -> SupportChoice | None:
    """The choice of the support, where the options leave it to the program.

    Light of later frames of a sequence can come from elsewhere than that of the first.
    """
    if options.support != "auto" or options.field is not None or options.is_sequence:
        return None

    def watch(fraction: float) -> bool:
        return run.reporter.step(
            "% of the choice of the support", round(100 * fraction), 100, "the picture"
        )

    return reconstructor.choose_support(measurement, progress=watch)


def _reconstruct_frame(run: Run[ReconstructOptions], setup: _Setup) -> Product[Tensor]:
    """The picture of one measurement."""
    options, reconstructor, problem = setup.options, setup.reconstructor, setup.problem
    stop = reconstructor.limits
    about = _about(setup, run.inputs)
    state = None
    if reconstructor.method is Method.ADMM:
        problem, state = _start(setup, about)
        setup = replace(setup, problem=problem)
    about["tau"] = tau = setup.tau

    def watch(progress: Progress) -> bool:
        return run.reporter.progress(progress, stop.iterations)

    result = reconstructor.solve(problem, state=state, callback=watch)
    picture = setup.picture(result.scene)
    white = exposure_white(picture)  # An empty picture is an error before anything is written.
    interrupted = result.stop_reason == "callback"
    psf = tensor_of(reconstructor.psf, "PSF")
    run.warn(*picture_warnings(problem, result, psf, options.iterations))
    report = Report.of(
        problem,
        result,
        psf,
        prediction=setup.prediction,
        method=reconstructor.method.value,
        automatic_tau=options.tau == "auto",
        automatic_support=setup.light is not None,
        seconds=run.clock.seconds,
        pixel_rad=setup.pixel_rad,
    )
    rgb = arrange_rgb(picture, setup.measurement.channels)
    write = partial(_write, white=white, options=options)
    writers: dict[Path, Writer] = {path: partial(write, picture=rgb) for path in options.output}
    if interrupted and state is not None:
        writers[options.state] = partial(write_state, arrays=state.arrays(), about=about)
    figures: dict[str, Any] = {
        "method": reconstructor.method.value,
        "iterations": result.iterations,
        "stop_reason": "interrupted" if interrupted else result.stop_reason,
        "objective": result.objective,
        "tau": tau,
        "automatic_tau": options.tau == "auto",
        "report": report.summary(),
        "automatic_support": setup.light is not None,
    }
    if options.sweep is not None and not interrupted:
        settings = sweep_settings(options, None, setup.measurement.size)
        swept = _sweep(run, setup, SweptPicture(None, settings, tau, result, rgb))
        writers |= sweep_writers(options, swept, white, write)
        figures["sweep"] = [each.row(options) for each in swept]
    parameters = {
        "bin": options.bin_by,
        "black": setup.development.black,
        "psf": _psf_row(setup.psf),
        "tau": tau,
        "support": setup.support,
        "supports": [] if setup.light is None else [step.row() for step in setup.light.steps],
        "weights": [] if setup.weight is None else [step.row() for step in setup.weight.steps],
        **asdict(stop),
        "fft_grid": list(problem.forward.geometry.padded),
        "sensor": list(problem.forward.sensor),
        "window": setup.window_on_sensor,
        "channel_names": list(setup.measurement.channels),
        "threads": torch.get_num_threads(),
    }
    return Product(picture, figures, writers, parameters, result.history)


def _sweep(run: Run[ReconstructOptions], setup: _Setup, own: SweptPicture) -> list[SweptPicture]:
    """Pictures with other values of an option, in the sheet's order; up to where it was ended.

    Each starts cold, so that it is what its option alone gives. From the picture before, ADMM
    takes 12 to 200 iterations, and about 64 from its start (decision 13).
    """
    options, sensor = setup.options, setup.measurement.size
    psf = tensor_of(setup.reconstructor.psf, "PSF")
    others = [name for name in options.swept_names if name is not None]
    pictures: dict[str | None, SweptPicture] = {None: own}
    for number, name in enumerate(others):
        changed = swept_options(options, name, sensor, own.tau)
        varied = setup.varied(run, changed, psf)
        watch = partial(_watch_sweep, run, number, len(others), varied.reconstructor.limits)
        result = varied.reconstructor.solve(varied.problem, callback=watch)
        if result.stop_reason == "callback":
            break
        picture = arrange_rgb(varied.picture(result.scene), setup.measurement.channels)
        settings = sweep_settings(options, name, sensor)
        pictures[name] = SweptPicture(name, settings, varied.problem.weight, result, picture)
    return [pictures[name] for name in options.swept_names if name in pictures]


def _watch_sweep(
    run: Run[ReconstructOptions], number: int, count: int, stop: Stop, progress: Progress
) -> bool:
    fraction = (number + progress.iteration / stop.iterations) / count
    return run.reporter.step("% of the sweep", round(100 * fraction), 100, "the pictures")


def _write(path: Path, picture: Tensor, white: float, options: ReconstructOptions) -> None:
    if path.suffix.lower() == ".png":
        write_png(path, picture, white)
    elif options.tiff_bits == 16:
        write_tiff16(path, picture)
    else:
        write_tiff32(path, picture)


def _reconstruct_sequence(run: Run[ReconstructOptions]) -> Product[Tensor]:
    """Reconstruct every frame of a folder or stack into a folder of pictures.

    The PSF, and all that follows from it, are prepared once, with the first frame that can be used;
    every later frame starts from the one before (`Stream`). A frame that cannot be used is
    dropped, with a warning. Pictures are written as they come, and share the white of the first.
    """
    options, reporter = run.options, run.reporter
    folder = _sequence_folder(options)
    frames = open_sequence(options.measurement, mosaic=options.mosaic, bgr=options.bgr)
    run.reads({f"frame {path.name}": path for path in frames.sources})
    run.begin()
    development = _read_development(options)
    setup: _Setup | None = None
    stream: Stream | None = None
    picture: Tensor | None = None
    white: float | None = None
    rows: list[dict[str, float]] = []
    choices: list[dict[str, float]] = []
    dropped: list[tuple[str, str]] = []
    count, interrupted = len(frames.names), False
    for number, name in enumerate(frames.names):
        try:
            frame = frames.read(number)
            if setup is None or stream is None:
                setup = _Setup.of(run, development, frame)
                stream = setup.reconstructor.stream(
                    setup.problem,
                    iterations=options.iterations or FOLLOWING,
                    latency_s=None if options.latency is None else options.latency.s,
                )
                measurement = setup.measurement
            else:
                measurement = setup.development.measurement(frame)
                if setup.weight is not None and len(rows) % CHECK_WEIGHT_EVERY == 0:
                    chosen = setup.reconstructor.choose_weight(measurement).tau / options.detail
                    stream.weigh(weight_to_follow(stream.weight, chosen))
                    choices.append({"frame": number + 1, "chosen": chosen, "tau": stream.weight})
            solved = stream.solve(
                measurement.values.to(run.device), measurement.valid.to(run.device)
            )
            current = setup.picture(solved.scene)
            white = exposure_white(current) if white is None else white
        except (NolensError, ArithmeticError) as error:
            if stream is None and isinstance(error, OptionError):
                raise
            dropped.append((name, str(error)))
            run.warn(f"{name} is dropped: {error}", aloud=len(dropped) <= _DROPS_REPORTED)
        else:
            picture = current
            rgb = arrange_rgb(picture, measurement.channels)
            write_into(
                folder, {folder / f"{name}.png": partial(write_png, radiance=rgb, white=white)}
            )
            rows.append(
                {
                    "frame": number + 1,
                    "iterations": solved.iterations,
                    "seconds": solved.seconds,
                    "tau": stream.weight,
                }
            )
        if reporter.step("frame", number + 1, count, "the pictures"):
            interrupted = True
            break
    silent = len(dropped) - _DROPS_REPORTED
    if silent > 0 and picture is not None:
        reporter.warn(f"{silent} more frames are dropped: {readable(options.record)} says why")
    if setup is None or picture is None:
        raise FileError(
            f"none of the {count} frames of {options.measurement} can be used: {dropped[0][1]}"
        )
    figures = {
        "method": Method.ADMM.value,
        "frames": len(rows),
        "dropped": [name for name, _ in dropped],
        "stop_reason": "interrupted" if interrupted else "end of the sequence",
    }
    parameters = {
        "bin": setup.options.bin_by,
        "black": setup.development.black,
        "psf": _psf_row(setup.psf),
        "tau": setup.tau,
        "tau_checks": choices,
        "support": setup.support,
        "white_radiance": white,
        "names": [name for name in frames.names if (folder / f"{name}.png").exists()],
        "threads": torch.get_num_threads(),
    }
    return Product(picture, figures, parameters=parameters, history=rows, outputs=(folder,))


def _sequence_folder(options: ReconstructOptions) -> Path:
    """The folder to write into, once the options are known to suit a sequence."""
    if len(options.output) != 1 or options.output[0].suffix:
        outputs = " ".join(str(path) for path in options.output)
        raise OptionError(
            f"{options.measurement} is a sequence of frames, whose pictures go into a folder; "
            f"given is -o {outputs}: give the name of a folder, such as -o pictures"
        )
    if _method(options) is not Method.ADMM or options.resume is not None:
        raise OptionError(
            "a sequence is solved by ADMM, each frame from the one before: leave out --method, "
            "--quality draft and --resume"
        )
    return options.output[0]


def _read_development(options: ReconstructOptions) -> Development:
    """Read all but the measurement."""
    psf = read_frame(options.psf)
    # Like the measurement as far as its channels allow: it may be grey.
    if len(psf.channels) == 3 and options.bgr:
        psf = read_frame(options.psf, bgr=True)
    elif len(psf.channels) != 3 and options.mosaic is not None and psf.mosaic is None:
        psf = read_frame(options.psf, mosaic=options.mosaic)
    dark, flat = (
        read_frame(path, mosaic=options.mosaic, bgr=options.bgr) if path else None
        for path in (options.dark, options.flat)
    )
    return Development(
        psf,
        dark,
        flat,
        black_level(options.black, psf),
        options.white,
        options.bin_by,
        options.channels,
    )


def _developed(
    run: Run[ReconstructOptions], development: Development, frame: Frame
) -> tuple[ReconstructOptions, Developed]:
    """A frame and the PSF, on pixels no finer than the PSF carries, unless --bin says otherwise.

    Also the options, with the binning that was chosen.
    """
    options = run.options
    if options.bin is not None:
        measurement = development.measurement(frame)
        return options, Developed(development, measurement, development.prepared(measurement), ())
    # Parts of the scene are in pixels, and would be others.
    coarsen = options.support in ("auto", "full") and options.crop in (None, "all")
    result = development.fitted(frame, SPARE[_method(options)], coarsen=coarsen)
    for text in result.notes:
        run.reporter.note(text)
    if result.development.bin_by > 1:
        options = options.model_copy(update={"bin": result.development.bin_by})
    return options, result


def _method(options: ReconstructOptions) -> Method:
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
    options: ReconstructOptions, psf: Tensor, support: PixelRectangle | None, device: torch.device
) -> Reconstructor:
    """The solver with the preset's limits, or the options' in their place."""
    method = _method(options)
    return Reconstructor(
        psf,
        support,
        tau=None if options.tau == "auto" else options.tau,
        prior=options.prior,
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
    )


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
    if (options.field is None) != (options.camera is None):
        raise OptionError(
            "--field needs --camera, and --camera is for --field: an angle becomes pixels by the "
            "camera's layers. Give both, such as --field 56deg --camera paper"
        )
    if options.field is None or options.camera is None:
        unlimited = options.support in ("auto", "full")
        return None if unlimited else parse_support(options.support, sensor, psf)
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


def _about(setup: _Setup, inputs: dict[str, InputFile]) -> dict[str, Any]:
    """What a run must have in common with one that goes on with its state."""
    values = setup.options.model_dump(mode="json")
    geometry = setup.development.psf_geometry
    return {
        **{role: file.sha256 for role, file in inputs.items()},
        "tau": setup.tau,
        **{name: values[name] for name in _PROBLEM_OPTIONS},
        "psf_scale": geometry.scale,
        "psf_extent": "wide" if geometry.extended else "sensor",
        "psf_flip": geometry.flip,
        "support": setup.support,
    }


def _start(setup: _Setup, about: dict[str, Any]) -> tuple[Problem, AdmmState]:
    """The problem, and where to start: from the state file that --resume names, or cold.

    A state of a run with other files or options, or an edited one, is an error. With an automatic
    τ it has the run's.
    """
    options, problem = setup.options, setup.problem
    if options.resume is None:
        return problem, AdmmState.cold(problem, options.penalties)
    stored_tau: list[float] = []

    def check_run(stored: Mapping[str, Any]) -> None:
        before = _in_present_names(stored)
        here = dict(about)
        if options.tau == "auto":
            # Of an edited state, anything.
            tau = before.get("tau")
            if isinstance(tau, float) and 0 < tau < math.inf:
                here["tau"] = tau
                stored_tau.append(tau)
        names = sorted(name for name in {*here, *before} if here.get(name) != before.get(name))
        if names:
            known = [name for name in names if name in here] or ["option"]
            raise OptionError(
                f"{options.resume} is the state of a run with another {' and '.join(known)}; give "
                "the same files and options again, or leave out --resume"
            )

    state = AdmmState.cold(problem)
    try:
        arrays = read_state(options.resume, state.arrays(), check_run)
        if stored_tau:
            problem = problem.weighted(stored_tau[0])
            state = AdmmState.cold(problem)
        state.restore_(arrays)
    except DataError as error:
        raise OptionError(f"{options.resume} does not fit this run: {error}") from None
    return problem, state


def _in_present_names(stored: Mapping[str, Any]) -> dict[str, Any]:
    """What a state says of its run; the names of the version before are read too."""
    about = {"support" if key == "region" else key: value for key, value in stored.items()}
    if "psf_wider" in about:
        about["psf_extent"] = "wide" if about.pop("psf_wider") else "sensor"
    about.setdefault("detail", 1.0)
    about.setdefault("psf_flip", "none")
    return about
