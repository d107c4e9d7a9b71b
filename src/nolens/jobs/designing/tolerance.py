"""How far off a camera may be made: from its description to trials, plots and a record."""

import math
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from nolens.amounts import amount
from nolens.design.tolerances import (
    MOST_STEPS,
    Allowed,
    Response,
    Sharpness,
    Study,
    Yield,
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
from nolens.files import (
    InputFile,
    RunRecord,
    camera_files,
    read_camera,
    readable,
    write_record,
    write_trials,
)
from nolens.files.folder import check_folder, write_into
from nolens.jobs.clock import Clock
from nolens.jobs.cost import duration_text
from nolens.jobs.designing.tolerance_options import ToleranceOptions
from nolens.jobs.designing.tolerance_ready import Ready, parameters_of, place_of, prepare
from nolens.jobs.designing.tolerance_summary import summary_of
from nolens.jobs.given import check_apart
from nolens.jobs.reporter import Reporter

_CURVES = 3
_POINTS = 9
_LONG_S = 20.0
_SLOW_S = 2


@dataclass(frozen=True)
class ToleranceOutcome:
    """What a study of tolerances came to.

    Parameters
    ----------
    study
        All that was found.
    summary
        Figures of the run, in values that JSON has.
    """

    study: Study
    summary: dict[str, Any]


def tolerances_text(camera: str, tolerances: Path | None) -> str:
    """Give the tolerances of a camera, assumed or from a file, as TOML text to edit.

    Raises
    ------
    NolensError
        If the camera or the file cannot be used.
    """
    opened = read_camera(camera)
    return parameters_to_toml(parameters_of(opened, tolerances), opened.camera)


def study_tolerances(options: ToleranceOptions, reporter: Reporter) -> ToleranceOutcome:
    """Read a camera and its tolerances, draw cameras, and write what was found.

    Parameters
    ----------
    options
        What to read, how to compute, where to write.
    reporter
        Sees notes and how far the work is; may stop it between two trials.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    clock = Clock()
    opened = read_camera(options.camera)
    files = {**options.inputs, **camera_files(options.camera, opened.camera)}
    check_apart(options, files)
    check_folder(options.output)
    ready = prepare(options, opened)
    inputs = {role: InputFile.of(path) for role, path in files.items()}

    with _one_thread():
        study, stopped = _study(options, ready, reporter)
    summary = {
        **summary_of(options, ready, study),
        "stop_reason": "interrupted" if stopped else "finished",
        "outputs": [readable(path) for _, path, _ in options.written],
        "seconds": clock.seconds,
    }
    record = RunRecord(
        started=clock.started,
        inputs=inputs,
        parameters={
            **options.model_dump(mode="json", by_alias=True),
            "camera_description": ready.camera.model_dump(mode="json"),
            "tolerance_description": parameters_to_toml(ready.parameters, ready.camera),
        },
        result=summary,
        history=[],
        warnings=[],
    )
    _write(options, study, record, summary)
    return ToleranceOutcome(study, summary)


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
    _announce(options, ready, reporter)
    better = ready.sharpness.smaller_is_better
    response = respond(
        ready.criterion,
        ready.parameters,
        smaller_is_better=better,
        at_once=ready.at_once,
        tick=partial(reporter.advance, "sensitivities"),
    )
    limit = _reachable(options, ready.sharpness, response)
    curves = _curves(ready, response)
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


def _announce(options: ToleranceOptions, ready: Ready, reporter: Reporter) -> None:
    """Say how long all cameras will take if that is long: one is timed, or foretold if slow."""
    if options.model == "rays":
        return
    one = ready.cost.seconds / ready.at_once
    if ready.cost.seconds < _SLOW_S:
        first = ready.cameras[: ready.at_once]
        ready.criterion(first)  # The first ones also load what the others need.
        clock = time.perf_counter()
        ready.criterion(first)
        one = (time.perf_counter() - clock) / len(first)
    count = len(ready.parameters) * (len(ready.parameters) + 1) + options.trials
    if options.solve is not None:
        count += MOST_STEPS * options.trials
    if one * count > _LONG_S:
        reporter.note(f"{count} patterns are simulated, about {duration_text(one * count)}")


def _reachable(options: ToleranceOptions, sharpness: Sharpness, response: Response) -> float | None:
    """The limit, if any of the cameras that were looked at so far meets it."""
    if not math.isfinite(response.nominal):
        raise OptionError(
            "the pattern of the camera as it is described has no line that could be measured: "
            "choose another --criterion, or a thickness nearer to the focus"
        )
    limit = options.limit_for(sharpness, response.nominal)
    if limit is None:
        return None
    best, unit = response.best, sharpness.unit
    if (limit < best) if sharpness.smaller_is_better else (limit > best):
        raise OptionError(
            f"--limit {options.limit} cannot be reached: the nominal camera has a {sharpness.name} "
            f"of {amount(response.nominal, unit, digits=4)}, and the best that the tolerances make "
            f"of it is {amount(best, unit, digits=4)}; give a limit of that or "
            + ("more" if sharpness.smaller_is_better else "less")
        )
    return limit


def _curves(ready: Ready, response: Response) -> dict[str, tuple[Tensor, Tensor]]:
    """Criterion over each of the worst offenders."""
    names = [each.name for each in ready.parameters]
    worst = [row.parameter.name for row in response.sensitivities if row.parameter.tolerance > 0]
    return {
        name: sweep(ready.criterion, ready.parameters, names.index(name), _POINTS)
        for name in worst[:_CURVES]
    }


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


def _write(
    options: ToleranceOptions, study: Study, record: RunRecord, summary: dict[str, Any]
) -> None:
    # Here, because matplotlib takes as long to load as some commands to run.
    from nolens.files.plot_tolerance import plot_tolerance

    title = (
        f"{summary['camera']}: {summary['criterion']} by {summary['model']}, light {options.light}"
    )
    paths = [path for _, path, _ in options.written]
    write_into(
        options.output,
        {
            paths[0]: partial(write_record, record=record),
            paths[1]: partial(write_trials, study=study),
            paths[2]: partial(plot_tolerance, study=study, title=title),
        },
    )
