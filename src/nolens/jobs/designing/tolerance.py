"""`nolens design tolerance`: how far off each part of a camera may be."""

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import torch
from pydantic import Field

from nolens.camera import Camera, LoadedCamera
from nolens.design.tolerances.parameters import Parameter, default_parameters, parameters_to_toml
from nolens.design.tolerances.sharpness import Limit, Sharpness
from nolens.design.tolerances.study import BudgetLine, Study, StudyPlan, Yield
from nolens.errors import DataError, OptionError
from nolens.fabricate import ToleranceBudget, poured_layer
from nolens.files import camera_files, read_camera, read_record, read_tolerances, write_trials
from nolens.files.tolerances import plot_tolerance
from nolens.jobs.fields import CAMERAS, FilePath, Name, Seed, Word
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Run, Writer, check_memory, job
from nolens.quantities import Share
from nolens.ranges import Between
from nolens.twin import Light

RECORD_FILE = "tolerance.json"
_TRIALS_FILE, _PLOT_FILE = "trials.csv", "tolerance.png"
_CRITERION, _TRIALS, _YIELD, _RESULT = "Criterion", "Trials", "Yield", "Result"
_Target = Annotated[Share, Between("0.01 %", "99.99 %")]
_ENOUGH = "1000 show a yield to within 2 or 3 %"
_MM = {"nm": 1e-6, "um": 1e-3, "mm": 1.0}


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
    target_yield: Annotated[
        _Target | None,
        Field(alias="yield"),
        Option(
            "Fraction of good cameras that --solve is for, such as 90%.", _YIELD, former="wanted"
        ),
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
        if (self.target_yield is None) != (self.solve is None):
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
        names = {"trials": _TRIALS_FILE, "plots": _PLOT_FILE, "record of the run": RECORD_FILE}
        return tuple(Written(what, self.output_folder / name) for what, name in names.items())


@job
def study_tolerances(run: Run[ToleranceOptions]) -> Product[Study | None]:
    """Read a camera and its tolerances, draw cameras, and write the result.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    loaded = read_camera(options.camera)
    run.reads(camera_files(options.camera, loaded.camera))
    if options.show:
        parameters = _parameters(options, loaded)
        return Product(None, {"tolerances": parameters_to_toml(parameters, loaded.camera)})
    plan = _plan(options, loaded)
    run.begin()
    study, stopped = plan.run(
        reporter.advance, lambda done, total: reporter.step("camera", done, total, "the trials")
    )
    summary = {
        **_summary(options, plan, study),
        "stop_reason": "interrupted" if stopped else "finished",
    }
    described = {
        "camera_description": plan.camera.model_dump(mode="json"),
        "tolerance_description": parameters_to_toml(plan.parameters, plan.camera),
    }
    return Product(study, summary, _writers(options, study, summary), described)


def _parameters(options: ToleranceOptions, loaded: LoadedCamera) -> tuple[Parameter, ...]:
    """Tolerances from a file, or what is assumed."""
    if options.tolerances is None:
        return default_parameters(loaded.camera)
    return read_tolerances(options.tolerances, loaded.camera)


def _plan(options: ToleranceOptions, loaded: LoadedCamera) -> StudyPlan:
    """Check all that can be checked before anything takes long."""
    sharpness, light = Sharpness.parse(options.criterion), Light(options.light)
    solve = None
    if options.solve is not None and options.target_yield is not None:
        solve = options.solve, options.target_yield.value
    plan = StudyPlan.of(
        loaded,
        _parameters(options, loaded),
        sharpness,
        light,
        rays=options.model == "rays",
        trials=options.trials,
        seed=options.seed,
        limit=options.limit,
        solve=solve,
    )
    check_memory(
        BYTES_OF_PROGRAM + plan.bytes_at_once,
        torch.device("cpu"),
        "thinner layers, or --model rays, need less",
    )
    return plan


def _summary(options: ToleranceOptions, plan: StudyPlan, study: Study) -> dict[str, Any]:
    """Figures of a study, in values that JSON has; None where there is no finite one."""
    response, finite = study.response, study.figures[study.figures.isfinite()]
    prediction = response.predict()
    height, width = plan.patch.side_um
    summary: dict[str, Any] = {
        "camera": plan.camera.name,
        "criterion": plan.sharpness.name,
        "unit": plan.sharpness.unit,
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
        parameter, target, allowed = study.solved
        summary["solved"] = {
            "parameter": parameter.name,
            "wanted_yield": target,
            "verdict": allowed.verdict,
            "tolerance": allowed.tolerance,
            "unit": parameter.unit,
            "reached": _yield_summary(allowed.reached),
        }
    return summary


def _yield_summary(good: Yield) -> dict[str, Any]:
    return {
        "share": good.fraction,
        "passed": good.passed,
        "trials": good.trials,
        "interval_95": list(good.interval()),
    }


def _finite_or_none(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _writers(
    options: ToleranceOptions, study: Study, summary: dict[str, Any]
) -> dict[Path, Writer]:
    assert options.output is not None
    title = (
        f"{summary['camera']}: {summary['criterion']} by {summary['model']}, light {options.light}"
    )
    return {
        options.output / _TRIALS_FILE: partial(write_trials, study=study),
        options.output / _PLOT_FILE: partial(plot_tolerance, study=study, title=title),
    }


def study_budget(path: Path, camera: Camera) -> ToleranceBudget:
    """Read the budget of a process sheet from the record of a study of tolerances.

    Parameters
    ----------
    path
        The record.
    camera
        The camera that it must be for.

    Raises
    ------
    FileError
        If the file cannot be read or is no record.
    DataError
        If it is the record of something else, or of another camera.
    """
    result = read_record(path).result
    if "budget" not in result or "criterion" not in result:
        raise DataError(
            f"{path} is no study of tolerances: give the folder that nolens design tolerance wrote"
        )
    if result["camera"] != camera.name:
        raise DataError(
            f"{path} is a study of {result['camera']!r}, not of {camera.name!r}: run nolens design "
            "tolerance for this camera"
        )
    lines = tuple(BudgetLine(**line) for line in result["budget"])
    passed = f"; {100 * result['yield']['share']:.3g} % meet the limit" if "yield" in result else ""
    method = (
        f"From nolens design tolerance: {result['criterion']} by {result['model']}, "
        f"{result['trials']} cameras drawn{passed}. What is allowed was assumed there: 2σ of "
        "a normal distribution, the farthest value of another."
    )
    thickness = f"{poured_layer(camera).name}.thickness"
    layer_mm = next(
        (line.allowed * _MM[line.unit] for line in lines if line.parameter == thickness), None
    )
    return ToleranceBudget(lines, method, layer_mm)
