"""`nolens design tolerance`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.amounts import amount
from nolens.cli.app import Json, Output, Quantity, Whole
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import ToleranceOptions, expand_home, study_tolerances, tolerances_text

Criterion = Parameter(group="Criterion")
Trials = Parameter(group="Trials")
Asked = Parameter(group="Yield")
Result = Parameter(group="Result")


def tolerance(
    camera: str,
    tolerances: Path | None = None,
    /,
    *,
    output: Annotated[Path | None, Output, Result] = None,
    criterion: Annotated[str | None, Criterion] = None,
    model: Annotated[Literal["wave", "rays"] | None, Criterion] = None,
    light: Annotated[str | None, Criterion] = None,
    trials: Annotated[int | None, Trials, Whole] = None,
    seed: Annotated[int | None, Trials, Whole] = None,
    limit: Annotated[str | None, Quantity, Asked] = None,
    yield_: Annotated[str | None, Parameter(name="--yield"), Quantity, Asked] = None,
    solve: Annotated[str | None, Asked] = None,
    show_: Annotated[bool, Parameter(name="--show", negative=(), show_default=False)] = False,
    json_: Annotated[bool, Json] = False,
) -> int:
    """How far off a camera may be made: what each part does, and how many cameras are good.

    nolens design tolerance paper --show > tolerances.toml
    nolens design tolerance paper tolerances.toml --limit 1.1x -o out

    Parameters
    ----------
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.
    tolerances
        .toml file of the parameters and their distributions.
        [default: what --show prints, all of it assumed]
    output
        Folder for tolerance.json, trials.csv and tolerance.png. Needed.
    criterion
        line-width (at half height), contrast, or mtf@ and a frequency such as mtf@40/mm, of the
        pattern of a point source at the camera's reference_distance.  [default: line-width]
    model
        wave: the twin's wave optics on a patch of the mask; rays: ray matrices and diffraction of
        its lenslets, quick and rough.  [default: wave]
    light
        white-led, daylight, equal-energy (in green), or one wavelength.  [default: 550nm]
    trials
        Cameras that are drawn.  [default: 1000]
    seed
        Of the random numbers.  [default: 0]
    limit
        What a good camera meets: 15um, 120% for contrast and MTF, or 1.1x the nominal figure.
    yield_
        Share of good cameras that --solve is for, such as 90%.
    solve
        Parameter whose largest tolerance for that yield is found, all others as given.
    show_
        Print the tolerances that would be used, to edit them, and do nothing else.
    json_
        Print one JSON object on standard output.
    """
    if show_:
        text = tolerances_text(camera, tolerances and expand_home(tolerances))
        for line in text.removesuffix("\n").split("\n"):
            show(line)
        return 0
    given = {
        "camera": camera,
        "tolerances": tolerances,
        "output": output,
        "criterion": criterion,
        "model": model,
        "light": light,
        "trials": trials,
        "seed": seed,
        "limit": limit,
        "yield": yield_,
        "solve": solve,
    }
    reporter = TerminalReporter()
    with reporter:
        options = ToleranceOptions.gather({k: v for k, v in given.items() if v is not None})
        summary = study_tolerances(options, reporter).summary
    if json_:
        show(json.dumps(summary))
    else:
        for line in _lines(summary):
            show(line)
    return 130 if reporter.interrupted else 0


def _lines(summary: dict[str, Any]) -> list[str]:
    unit, rows = summary["unit"], summary["sensitivities"]
    lines = [
        f"{summary['criterion']} {amount(summary['nominal'], unit, digits=4)} with every parameter "
        "at its mean; change at − and + its tolerance, the worst first:"
    ]
    wide = max(len(row["parameter"]) for row in rows)
    for row in rows:
        mean = amount(row["mean"], digits=6)
        varied = f"{mean} ± {amount(row['tolerance'], row['unit'], digits=4)}"
        varied += f" ({row['tolerance_means']})"
        changes = (
            "not measurable" if row[key] is None else amount(row[key], unit, sign=True)
            for key in ("change_at_minus", "change_at_plus")
        )
        assumed = "  assumed" if row["note"].startswith("assumed") else ""
        lines.append(f"  {row['parameter']:<{wide}}  {varied:<28} {' / '.join(changes)}{assumed}")
    lines += _drawn(summary)
    if "solved" in summary:
        lines.append(_solved(summary["solved"]))
    return [*lines, f"{summary['seconds']:.1f} s", *summary["outputs"]]


def _drawn(summary: dict[str, Any]) -> list[str]:
    unit, predicted = summary["unit"], summary["prediction"]
    lines = []
    if predicted["second_order_sigma"] is not None:
        lines.append(
            f"predicted: mean {amount(predicted['mean'], unit, digits=4)}, sigma "
            f"{amount(predicted['second_order_sigma'], unit)} ("
            f"{amount(predicted['root_sum_square_sigma'], unit)} by "
            "the root of the sum of squares alone)"
        )
    if summary["sigma"] is not None:
        lines.append(
            f"{summary['trials']} cameras drawn: mean "
            f"{amount(summary['mean'], unit, digits=4)}, sigma {amount(summary['sigma'], unit)}"
        )
    if summary["not_measurable"]:
        lines.append(f"{summary['not_measurable']} of them show no lines that could be measured")
    reached = (
        f"{level} {'none' if value is None else amount(value, unit, digits=4)}"
        for level, value in summary["levels"].items()
    )
    lines.append(f"this good or better: {', '.join(reached)}")
    if "yield" in summary:
        limit = amount(summary["limit"], unit, digits=4)
        lines.append(f"{_share(summary['yield'])} meet the limit of {limit}")
    return lines


def _share(found: dict[str, Any]) -> str:
    low, high = found["interval_95"]
    return f"{100 * found['share']:.1f} % (95 % interval {100 * low:.1f} to {100 * high:.1f} %)"


def _solved(solved: dict[str, Any]) -> str:
    allowed = f"± {amount(solved['tolerance'], solved['unit'])}"
    wanted, reached = f"{100 * solved['wanted_yield']:g} %", _share(solved["reached"])
    if solved["verdict"] == "impossible":
        return (
            f"no tolerance of {solved['parameter']} gives a yield of {wanted}: even with none it "
            f"is {reached}"
        )
    if solved["verdict"] == "any":
        return (
            f"any tolerance of {solved['parameter']} up to {allowed}, the largest possible one, "
            f"gives a yield of {wanted}: {reached}"
        )
    return f"{solved['parameter']} may be {allowed} for a yield of {wanted}: {reached}"
