"""`nolens design tolerance`: how far off each part of a camera may be."""

import math
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import ConfigDict, Field, RootModel
from torch import Tensor

from nolens.amounts import amount
from nolens.camera import Camera, OpenCamera
from nolens.design.tolerances import (
    MOST_STEPS,
    Allowed,
    Criterion,
    Parameter,
    Patch,
    RayModel,
    Response,
    Sharpness,
    Study,
    WaveModel,
    Yield,
    check_possible,
    criterion_of,
    default_parameters,
    draw,
    evaluate,
    find,
    largest_possible,
    largest_tolerance,
    leaves_thickness,
    parameters_to_toml,
    respond,
    sweep,
    variables,
)
from nolens.errors import OptionError
from nolens.files import camera_files, read_camera, read_tolerances, write_trials
from nolens.files.tolerances import plot_tolerance
from nolens.jobs.fields import CAMERAS, FilePath, Name, Seed, Word
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Reporter, Run, Writer, check_memory, job
from nolens.optics import PointSource
from nolens.quantities import Length, Share
from nolens.ranges import Between
from nolens.twin import Light, colours_of, polychromatic_psf_bytes, preview_model, simulation_bytes

RECORD_FILE, TRIALS_FILE, PLOT_FILE = "tolerance.json", "trials.csv", "tolerance.png"
_TIMES = re.compile(r"\s*([0-9]+(?:\.[0-9]*)?|\.[0-9]+)\s*[x×]\s*")
_CRITERION, _TRIALS, _YIELD, _RESULT = "Criterion", "Trials", "Yield", "Result"
_Wanted = Annotated[Share, Between("0.01 %", "99.99 %")]
_ENOUGH = "1000 show a yield to within 2 or 3 %"
_WAVELENGTHS = 3
_AT_ONCE = 1000
_CPU = torch.device("cpu")
_CURVES = 3
_POINTS = 9


class Limit(RootModel[Annotated[str, Field(max_length=40)]]):
    """What a good camera meets: a length, a fraction, or so many times the nominal figure."""

    model_config = ConfigDict(frozen=True)

    def __str__(self) -> str:
        return self.root

    def value(self, sharpness: Sharpness, nominal: float) -> float:
        """The limit in the criterion's unit.

        Parameters
        ----------
        sharpness
            The criterion.
        nominal
            Its figure with every parameter in its middle.

        Raises
        ------
        OptionError
            If the text is no limit for this criterion.
        """
        times = _TIMES.fullmatch(self.root)
        if times is not None:
            limit = float(times[1]) * nominal
        else:
            kind = Length if sharpness.unit == "um" else Share
            try:
                limit = kind.parse(self.root).to(sharpness.unit)
            except OptionError as error:
                raise OptionError(
                    f"--limit: {error}; or give it as a multiple of the nominal figure, such as "
                    "1.2x"
                ) from None
        if not limit > 0:
            raise OptionError(f"--limit {self} is not more than zero: nothing meets it")
        return limit


class ToleranceOptions(JobOptions):
    """How far off a camera may be made: what each part does, and how many cameras are good.

    nolens design tolerance paper --show > tolerances.toml
    nolens design tolerance paper tolerances.toml --limit 1.1x -o out
    """

    usage = "design tolerance CAMERA [TOLERANCES.toml] -o FOLDER"

    camera: Annotated[
        Name,
        Option(
            f"{CAMERAS}.",
            needed="the camera (nolens design tolerance CAMERA -o FOLDER)",
            role="camera",
            positional=True,
        ),
    ]
    tolerances: Annotated[
        FilePath | None,
        Option(
            ".toml file of the parameters and their distributions.",
            default="what --show prints, all of it assumed",
            role="input",
            positional=True,
        ),
    ] = None
    output: Annotated[
        FilePath | None,
        Option(
            "Folder for tolerance.json, trials.csv and tolerance.png. Needed, but for --show.",
            _RESULT,
            role="output",
            flag="-o",
        ),
    ] = None
    criterion: Annotated[
        Word,
        Option(
            "line-width (at half height), contrast, or mtf@ and a frequency such as mtf@40/mm, of "
            "the pattern of a point source at the camera's reference_distance.",
            _CRITERION,
        ),
    ] = "line-width"
    model: Annotated[
        Literal["wave", "rays"],
        Option(
            "wave: the twin's wave optics on a patch of the mask; rays: ray matrices and "
            "diffraction of its lenslets, quick and rough.",
            _CRITERION,
        ),
    ] = "wave"
    light: Annotated[
        Word,
        Option("white-led, daylight, equal-energy (in green), or one wavelength.", _CRITERION),
    ] = "550nm"
    trials: Annotated[
        int,
        Between(10, 1_000_000, _ENOUGH),
        Option("Cameras that are drawn.", _TRIALS),
    ] = 1000
    seed: Annotated[Seed, Option("Of the random numbers.", _TRIALS)] = 0
    limit: Annotated[
        Limit | None,
        Option(
            "What a good camera meets: 15um, 120% for contrast and MTF, or 1.1x the nominal "
            "figure.",
            _YIELD,
        ),
    ] = None
    wanted: Annotated[
        _Wanted | None,
        Field(alias="yield"),
        Option("Fraction of good cameras that --solve is for, such as 90%.", _YIELD),
    ] = None
    solve: Annotated[
        Word | None,
        Option(
            "Parameter whose largest tolerance for that yield is found, all others as given.",
            _YIELD,
        ),
    ] = None
    show: Annotated[
        bool,
        Option(
            "Print the tolerances that would be used, to edit them, and do nothing else.",
            negative=False,
        ),
    ] = False

    def check_together(self) -> None:
        """Refuse a study without a folder, and a yield without what it is for."""
        if self.show:
            return
        if self.output is None:
            raise OptionError("no output is given; name a folder for the trials and plots (-o out)")
        if (self.wanted is None) != (self.solve is None):
            raise OptionError(
                "--yield and --solve go together: the yield that is wanted, and the parameter "
                "whose tolerance is to be found, such as --yield 90% --solve resin.thickness"
            )
        if self.solve is not None and self.limit is None:
            raise OptionError(
                "--solve needs a limit that the cameras have to meet: give --limit, such as 1.2x"
            )

    @property
    def output_folder(self) -> Path | None:
        """It is made where it does not exist; none where the tolerances are only shown."""
        return None if self.show else self.output

    @property
    def record(self) -> Path | None:
        """File of the run's record."""
        return None if self.output_folder is None else self.output_folder / RECORD_FILE

    @property
    def written(self) -> tuple[Written, ...]:
        """Trials, plots and record."""
        if self.output_folder is None:
            return ()
        names = {"trials": TRIALS_FILE, "plots": PLOT_FILE, "record of the run": RECORD_FILE}
        return tuple(Written(what, self.output_folder / name) for what, name in names.items())


@dataclass(frozen=True)
class Ready:
    """A study that has been checked and can be computed.

    Parameters
    ----------
    camera
        The description.
    parameters
        What varies.
    sharpness
        The criterion's kind.
    patch
        Of the mask.
    criterion
        From cameras to their figures.
    at_once
        Cameras that are computed in one portion.
    cameras
        Drawn, (trials, parameters).
    """

    camera: Camera
    parameters: tuple[Parameter, ...]
    sharpness: Sharpness
    patch: Patch
    criterion: Criterion
    at_once: int
    cameras: Tensor


def parameters_of(opened: OpenCamera, tolerances: Path | None) -> tuple[Parameter, ...]:
    """Tolerances from a file, or what is assumed.

    Raises
    ------
    NolensError
        If the file cannot be used, or the camera's mask is flat.
    """
    if tolerances is None:
        return default_parameters(opened.camera)
    return read_tolerances(tolerances, opened.camera)


def prepare(options: ToleranceOptions, opened: OpenCamera) -> Ready:
    """Check all that can be checked before anything takes long.

    Raises
    ------
    NolensError
        If an option, the tolerances or the camera cannot be used.
    """
    sharpness, light = Sharpness.parse(options.criterion), Light(options.light)
    parameters = parameters_of(opened, options.tolerances)
    if options.limit is not None:
        options.limit.value(sharpness, 1.0)
    if options.solve is not None:
        place_of(options.solve, parameters, opened.camera)
    cameras = draw(parameters, options.trials, options.seed)
    check_possible(opened.camera, parameters, cameras)
    preview_model(opened)  # Refuses a relief that is coarser than it must be.
    patch = Patch.of(opened)
    sharpness.check(patch.twin.sensor_pitch_um, patch.lenslets.pitch_um)
    channels = colours_of(patch.twin, light, _WAVELENGTHS)
    colours = channels[len(channels) // 2]
    threads = torch.get_num_threads()
    model: WaveModel | RayModel = WaveModel(patch, sharpness, colours, threads)
    if options.model == "rays":
        model = RayModel(patch, sharpness, sum(nm * weight for nm, weight in colours))
    criterion = criterion_of(model, opened.camera, tuple(each.name for each in parameters))
    at_once = _AT_ONCE if options.model == "rays" else threads
    if options.model == "wave":
        needed = BYTES_OF_PROGRAM + at_once * _bytes_of_camera(patch, colours)
        check_memory(needed, _CPU, "thinner layers, or --model rays, need less")
    return Ready(opened.camera, parameters, sharpness, patch, criterion, at_once, cameras)


def _bytes_of_camera(patch: Patch, colours: tuple[tuple[float, float], ...]) -> float:
    """Memory that the pattern of one camera takes."""
    twin = patch.twin
    source = PointSource(distance_um=twin.camera.reference_distance.um)
    cells = round(patch.side_um[0] / twin.pixel_um), round(patch.side_um[1] / twin.pixel_um)
    pattern = polychromatic_psf_bytes(
        twin, source, cells, twin.superpixel, at_least=2, shortest=min(nm for nm, _ in colours)
    )
    return simulation_bytes(twin.mask.relief.height_um.numel(), pattern)


def place_of(name: str, parameters: tuple[Parameter, ...], camera: Camera) -> int:
    """Place of a parameter among those that vary.

    Raises
    ------
    OptionError
        If the camera has none of this name, or it does not vary.
    """
    full = find(variables(camera), camera, name).name
    names = [each.name for each in parameters]
    if full not in names:
        raise OptionError(
            f"--solve {name}: it is not among the parameters of the tolerances, which are "
            f"{', '.join(names)}: add it, with any tolerance and its distribution"
        )
    return names.index(full)


def summary_of(options: ToleranceOptions, ready: Ready, study: Study) -> dict[str, Any]:
    """Figures of a study, in values that JSON has; None where there is no finite one.

    Parameters
    ----------
    options
        What was asked for.
    ready
        What was computed.
    study
        What was found.
    """
    response, finite = study.response, study.figures[study.figures.isfinite()]
    prediction = response.predict()
    height, width = ready.patch.side_um
    summary: dict[str, Any] = {
        "camera": ready.camera.name,
        "criterion": ready.sharpness.name,
        "unit": ready.sharpness.unit,
        "model": options.model,
        "light": options.light,
        "patch_mm": [round(height * 1e-3, 4), round(width * 1e-3, 4)],
        "nominal": response.nominal,
        "sensitivities": [
            {
                "parameter": row.parameter.name,
                "distribution": row.parameter.distribution,
                "mean": row.parameter.middle,
                "tolerance": row.parameter.tolerance,
                "tolerance_means": row.parameter.tolerance_means,
                "unit": row.parameter.unit,
                "change_at_minus": _finite_or_none(row.minus),
                "change_at_plus": _finite_or_none(row.plus),
                "linear": _finite_or_none(row.linear),
                "quadratic": _finite_or_none(row.quadratic),
                "note": row.parameter.note,
            }
            for row in response.sensitivities
        ],
        "budget": [asdict(line) for line in study.budget],
        "prediction": {
            "mean": _finite_or_none(prediction.mean),
            "root_sum_square_sigma": _finite_or_none(prediction.linear_sigma),
            "second_order_sigma": _finite_or_none(prediction.sigma),
        },
        "trials": len(study.figures),
        "not_measurable": len(study.figures) - len(finite),
        "mean": _finite_or_none(float(finite.mean())) if len(finite) else None,
        "sigma": _finite_or_none(float(finite.std())) if len(finite) > 1 else None,
        "levels": {f"{100 * k:.0f} %": _finite_or_none(v) for k, v in study.levels.items()},
        "limit": study.limit,
    }
    if study.passed is not None:
        summary["yield"] = _yield_summary(study.passed)
    if study.solved is not None:
        name, wanted, allowed = study.solved
        unit = next(each.unit for each in ready.parameters if each.name == name)
        summary["solved"] = {
            "parameter": name,
            "wanted_yield": wanted,
            "verdict": allowed.verdict,
            "tolerance": allowed.tolerance,
            "unit": unit,
            "reached": _yield_summary(allowed.reached),
        }
    return summary


def _yield_summary(found: Yield) -> dict[str, Any]:
    return {
        "share": found.share,
        "passed": found.passed,
        "trials": found.trials,
        "interval_95": list(found.interval()),
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


@job
def study_tolerances(run: Run[ToleranceOptions]) -> Product[Study | None]:
    """Read a camera and its tolerances, draw cameras, and write what was found.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options = run.options
    opened = read_camera(options.camera)
    run.reads(camera_files(options.camera, opened.camera))
    if options.show:
        parameters = parameters_of(opened, options.tolerances)
        return Product(None, {"tolerances": parameters_to_toml(parameters, opened.camera)})
    ready = prepare(options, opened)
    run.begin()
    with _one_thread():
        study, stopped = _study(options, ready, run.reporter)
    summary = {
        **summary_of(options, ready, study),
        "stop_reason": "interrupted" if stopped else "finished",
    }
    described = {
        "camera_description": ready.camera.model_dump(mode="json"),
        "tolerance_description": parameters_to_toml(ready.parameters, ready.camera),
    }
    return Product(study, summary, _writers(options, study, summary), described)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Leave the threads to cameras: for one of them alone, torch's cost more than they give."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _study(options: ToleranceOptions, ready: Ready, reporter: Reporter) -> tuple[Study, bool]:
    """Compute all, and whether a person stopped it."""
    better = ready.sharpness.smaller_is_better
    response = respond(
        ready.criterion,
        ready.parameters,
        smaller_is_better=better,
        at_once=ready.at_once,
        tick=partial(reporter.advance, "sensitivities"),
    )
    limit = _reachable(options, ready.sharpness, response)
    curves = _curves(ready, response, partial(reporter.advance, "curves"))
    figures = evaluate(
        ready.criterion,
        ready.cameras,
        at_once=ready.at_once,
        stop=lambda done: reporter.step("camera", done, options.trials, "the trials"),
    )
    solved = None
    stopped = len(figures) < options.trials
    if options.solve is not None and options.wanted is not None and limit is not None:
        wanted = options.wanted.value
        allowed = None if stopped else _solve(options, ready, limit, wanted, reporter)
        stopped = allowed is None
        if allowed is not None:
            name = find(variables(ready.camera), ready.camera, options.solve).name
            solved = name, wanted, allowed
    return Study(ready.sharpness, response, ready.cameras, figures, curves, limit, solved), stopped


def _reachable(options: ToleranceOptions, sharpness: Sharpness, response: Response) -> float | None:
    """The limit, if any of the cameras that were looked at so far meets it."""
    if not math.isfinite(response.nominal):
        raise OptionError(
            "the pattern of the camera as it is described has no line that could be measured: "
            "choose another --criterion, or a thickness nearer to the focus"
        )
    if options.limit is None:
        return None
    limit = options.limit.value(sharpness, response.nominal)
    best, unit = response.best, sharpness.unit
    if (limit < best) if sharpness.smaller_is_better else (limit > best):
        raise OptionError(
            f"--limit {options.limit} cannot be reached: the nominal camera has a {sharpness.name} "
            f"of {amount(response.nominal, unit, digits=4)}, and the best that the tolerances make "
            f"of it is {amount(best, unit, digits=4)}; give a limit of that or "
            + ("more" if sharpness.smaller_is_better else "less")
        )
    return limit


def _curves(
    ready: Ready, response: Response, tick: Callable[[float], None]
) -> dict[str, tuple[Tensor, Tensor]]:
    """Criterion over each of the worst offenders."""
    names = [each.name for each in ready.parameters]
    rows = [row.parameter for row in response.sensitivities if row.parameter.tolerance > 0]
    curves = {}
    for number, worst in enumerate(rows[:_CURVES]):
        tick(number / len(rows[:_CURVES]))
        at = names.index(worst.name)
        curves[worst.name] = sweep(ready.criterion, ready.parameters, at, _POINTS)
    return curves


def _solve(
    options: ToleranceOptions, ready: Ready, limit: float, wanted: float, reporter: Reporter
) -> Allowed | None:
    """Largest tolerance of one parameter for a yield; None where a person stopped it."""
    assert options.solve is not None
    number = place_of(options.solve, ready.parameters, ready.camera)
    asked = ready.parameters[number]
    if asked.tolerance == 0:
        asked = asked.with_tolerance(1.0)
    allowed = find(variables(ready.camera), ready.camera, asked.name)

    def cameras(tolerance: float) -> Tensor:
        varied = asked.with_tolerance(tolerance)
        chosen = (*ready.parameters[:number], varied, *ready.parameters[number + 1 :])
        return draw(chosen, options.trials, options.seed)

    drawn = cameras(asked.tolerance)[:, number]
    bound = 0.999 * largest_possible(allowed, asked, drawn)
    while not leaves_thickness(ready.camera, ready.parameters, cameras(bound)):
        bound /= 2
    steps = 0

    def yield_with(tolerance: float) -> Yield:
        nonlocal steps
        total = max(MOST_STEPS, steps + 1) * options.trials
        before = steps * options.trials
        figures = evaluate(
            ready.criterion,
            cameras(tolerance),
            at_once=ready.at_once,
            stop=lambda done: reporter.step("camera", before + done, total, "the trials"),
        )
        if len(figures) < options.trials:
            raise _StoppedError
        steps += 1
        return Yield.of(figures, limit, smaller_is_better=ready.sharpness.smaller_is_better)

    try:
        return largest_tolerance(yield_with, wanted, bound)
    except _StoppedError:
        return None


class _StoppedError(Exception):
    """A person stopped the search between two trials."""


def _writers(
    options: ToleranceOptions, study: Study, summary: dict[str, Any]
) -> dict[Path, Writer]:
    assert options.output is not None
    title = (
        f"{summary['camera']}: {summary['criterion']} by {summary['model']}, light {options.light}"
    )
    return {
        options.output / TRIALS_FILE: partial(write_trials, study=study),
        options.output / PLOT_FILE: partial(plot_tolerance, study=study, title=title),
    }
