"""`nolens design tolerance`: how far off each part of a camera may be."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from nolens.camera import LoadedCamera
from nolens.design.tolerances.parameters import Parameter, default_parameters, parameters_to_toml
from nolens.design.tolerances.sharpness import Limit, Sharpness
from nolens.design.tolerances.study import Study, StudyPlan
from nolens.errors import OptionError
from nolens.files import read_tolerances, write_trials
from nolens.files.tolerances import RECORD_FILE, plot_tolerance
from nolens.jobs.fields import CAMERAS, FilePath, Name, Seed, Word
from nolens.jobs.options import RECORD, JobOptions, Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.machine import BYTES_OF_PROGRAM
from nolens.quantities import Percentage
from nolens.ranges import Between
from nolens.twin import Light

_TRIALS_FILE, _PLOT_FILE = "trials.csv", "tolerance.png"
_CRITERION, _TRIALS, _YIELD = "Criterion", "Trials", "Yield"
_Target = Annotated[Percentage, Between("0.01 %", "99.99 %")]
_ENOUGH = "1000 show a yield to within 2 or 3 %"


class ToleranceOptions(JobOptions):
    """How far off a camera may be made: what each part does, and how many cameras are good.

    nolens design tolerance paper --show > tolerances.toml
    nolens design tolerance paper tolerances.toml --limit 1.1x -o out
    """

    usage = "design tolerance CAMERA [TOLERANCES.toml] -o FOLDER"

    camera: Annotated[
        Name,
        Option(
            f"Camera to study: {CAMERAS}.",
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
            "Folder for tolerance.json, trials.csv and tolerance.png. Not needed with --show.",
            role="output",
            flag="-o",
        ),
    ] = None
    criterion: Annotated[
        Word,
        Option(
            "What is measured of the PSF at the camera's reference_distance: line-width (at half "
            "height), contrast, or mtf@ and a frequency such as mtf@40/mm.",
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
            "Parameter to find the largest tolerance of for that yield; the others stay.",
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
        names = {"trials": _TRIALS_FILE, "plots": _PLOT_FILE, RECORD: RECORD_FILE}
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
    loaded = run.camera(options.camera)
    if options.show:
        parameters = _parameters(options, loaded)
        return Product(None, {"tolerances": parameters_to_toml(parameters, loaded.camera)})
    plan = _plan(options, loaded)
    needed = BYTES_OF_PROGRAM + plan.bytes_at_once
    run.begin(needed, "thinner layers, or --model rays, need less")
    study, stopped = plan.run(
        reporter.advance, lambda done, total: reporter.step("camera", done, total, "the trials")
    )
    summary = {
        "camera": plan.camera.name,
        "criterion": plan.sharpness.name,
        "unit": plan.sharpness.unit,
        "model": options.model,
        "light": options.light,
        "patch_mm": [round(side * 1e-3, 4) for side in plan.patch.side_um],
        **study.summary(),
        "stop_reason": "interrupted" if stopped else "finished",
    }
    described = {
        "camera_description": plan.camera.model_dump(mode="json"),
        "tolerance_description": parameters_to_toml(plan.parameters, plan.camera),
    }
    assert options.output is not None
    title = f"{plan.camera.name}: {plan.sharpness.name} by {options.model}, light {options.light}"
    writers = {
        options.output / _TRIALS_FILE: partial(write_trials, study=study),
        options.output / _PLOT_FILE: partial(plot_tolerance, study=study, title=title),
    }
    return Product(study, summary, writers, described)


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
    return StudyPlan.of(
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
