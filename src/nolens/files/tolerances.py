"""Files of a study of tolerances: what a person wrote down, the cameras drawn, and a plot."""

import csv
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nolens.amounts import amount, unit_text
from nolens.camera import Camera
from nolens.design.tolerances.parameters import Parameter, parameters_from_toml
from nolens.design.tolerances.study import BudgetLine, Study
from nolens.errors import DataError
from nolens.fabricate import ToleranceBudget, poured_layer
from nolens.files.input import read_text
from nolens.files.plots import plot_figure
from nolens.files.record import read_record

if TYPE_CHECKING:
    from matplotlib.axes import Axes

RECORD_FILE = "tolerance.json"
"""Record of a study, in its folder."""
_MM = {"nm": 1e-6, "um": 1e-3, "mm": 1.0}
_BETTER, _WORSE, _NEUTRAL, _LIMIT = "#2a7f62", "#c0562f", "#5b6b7a", "#a01c3a"
_MOST_BARS = 10
_LEVELS = (0.50, 0.90, 0.98)


def read_tolerances(path: str | Path, camera: Camera) -> tuple[Parameter, ...]:
    """Read the tolerances of a camera, as ``nolens design tolerance CAMERA --show`` prints them.

    Raises
    ------
    FileError
        If there is no such file, or it cannot be read.
    DataError
        If it holds no table of tolerances.
    OptionError
        If a parameter, a distribution or a quantity in it cannot be used.
    """
    text = read_text(
        path, advice="Give a .toml file such as nolens design tolerance CAMERA --show prints"
    )
    return parameters_from_toml(text, str(path), camera)


def write_trials(path: Path, study: Study) -> None:
    """Write all cameras that were drawn, as CSV: number, parameters, criterion."""
    parameters = study.response.parameters
    sharpness = study.sharpness
    heads = [*((each.name, each.unit) for each in parameters), (sharpness.name, sharpness.unit)]
    with path.open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["trial", *(f"{name} [{unit}]" if unit else name for name, unit in heads)])
        # Cameras that were not computed before a person stopped the work are left out.
        done = zip(study.cameras.tolist(), study.figures.tolist(), strict=False)
        for number, (camera, figure) in enumerate(done, start=1):
            rows.writerow([number, *camera, figure])


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
    passed = ""
    if "yield" in result:
        counts = result["yield"]  # Of the version before: "share".
        fraction = counts["fraction"] if "fraction" in counts else counts["share"]
        passed = f"; {100 * fraction:.3g} % meet the limit"
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


def plot_tolerance(path: Path, study: Study, title: str) -> None:
    """Draw how the figures of all cameras lie, what each parameter does, and the worst ones."""
    with plot_figure(path, (11, 8), title_size="large") as figure:
        figure.suptitle(title)
        above, below = figure.subfigures(2, 1, squeeze=False)[:, 0]
        left, right = above.subplots(1, 2)
        _draw_figures(left, study)
        _draw_bars(right, study)
        if study.curves:
            places = below.subplots(1, len(study.curves), sharey=True, squeeze=False)[0]
            for axes, name in zip(places, study.curves, strict=True):
                _draw_curve(axes, study, name)
            places[0].set_ylabel(_label(study))
            places[0].legend(fontsize=7, loc="best")


def _draw_figures(axes: "Axes", study: Study) -> None:
    """Histogram of all cameras, and the fraction of them that is better."""
    sharpness = study.sharpness
    figures = study.figures.numpy()
    finite = np.sort(figures[np.isfinite(figures)])
    if len(finite) == 0:
        axes.set_title("no camera's PSF could be measured")
        return
    axes.hist(finite, bins=min(40, max(5, len(finite) // 10)), color=_NEUTRAL, alpha=0.45)
    axes.set_ylabel("cameras")
    fraction = axes.twinx()
    fraction.spines["right"].set_visible(True)
    places = np.arange(1, len(finite) + 1) / len(figures)
    ordered = finite if sharpness.smaller_is_better else finite[::-1]
    fraction.plot(ordered, 100 * places, color="black", linewidth=1.4)
    fraction.set_ylim(0, 102)
    fraction.set_ylabel("fraction that is this good or better, %")
    levels = {level: study.levels[level] for level in _LEVELS if np.isfinite(study.levels[level])}
    fraction.plot(
        [*levels.values()], [100 * level for level in levels], "o", color="black", markersize=4
    )
    # Below the plot: over the histogram they cannot be read.
    reached = [
        f"{100 * level:.0f} %: {amount(value, sharpness.unit, digits=4)}"
        for level, value in levels.items()
    ]
    axes.set_xlabel(_label(study) + "\n" + " · ".join(reached))
    passed = study.passed
    text = f"{len(figures)} cameras"
    if study.limit is not None and passed is not None:
        low, high = passed.interval()
        axes.axvline(study.limit, color=_LIMIT, linestyle="--", linewidth=1.2)
        text += (
            f"; {100 * passed.fraction:.1f} % meet "
            f"{amount(study.limit, sharpness.unit, digits=4)}\n"
            f"(95 % interval {100 * low:.1f} to {100 * high:.1f} %)"
        )
    axes.set_title(text)


def _draw_bars(axes: "Axes", study: Study) -> None:
    """What each parameter does at − and + its tolerance, the worst offender on top."""
    rows = study.response.sensitivities[:_MOST_BARS][::-1]
    for place, row in enumerate(rows):
        for change, sign in ((row.minus, "−"), (row.plus, "+")):
            better = (change < 0) == study.sharpness.smaller_is_better
            if np.isfinite(change):
                axes.barh(place, change, 0.7, color=_BETTER if better else _WORSE, alpha=0.8)
                if abs(change) > 0.04 * rows[-1].worst:
                    axes.annotate(
                        sign,
                        (change, place),
                        (4 if change > 0 else -4, 0),
                        textcoords="offset points",
                        va="center",
                        ha="left" if change > 0 else "right",
                    )
    axes.axvline(0, color="black", linewidth=0.8)
    axes.margins(x=0.08)
    axes.set_yticks(range(len(rows)), [_amount(row.parameter) for row in rows])
    axes.set_xlabel(f"change of the {_label(study)}")
    axes.set_title("each parameter at − and + its tolerance\n(green is better, red is worse)")


def _draw_curve(axes: "Axes", study: Study, name: str) -> None:
    """Criterion over one parameter alone, among the cameras that were drawn."""
    parameters = study.response.parameters
    number = [each.name for each in parameters].index(name)
    drawn = study.cameras[: len(study.figures), number].numpy()
    axes.plot(
        drawn,
        _measured(study.figures),
        ".",
        color=_NEUTRAL,
        markersize=3,
        alpha=0.6 if len(drawn) < 300 else 0.25,
        label="cameras drawn",
    )
    values, figures = study.curves[name]
    axes.plot(
        values.numpy(),
        _measured(figures),
        color="black",
        linewidth=1.6,
        label="this parameter alone",
    )
    if study.limit is not None:
        axes.axhline(study.limit, color=_LIMIT, linestyle="--", linewidth=1.2, label="limit")
    unit = parameters[number].unit
    axes.set_xlabel(f"{name}, {unit}" if unit else name)
    axes.locator_params(axis="x", nbins=5)


def _measured(figures: Tensor) -> NDArray[np.float64]:
    """Figures with gaps where nothing could be measured."""
    values: NDArray[np.float64] = figures.numpy()
    return np.where(np.isfinite(values), values, np.nan)


def _label(study: Study) -> str:
    return f"{study.sharpness.name}, {unit_text(study.sharpness.unit)}"


def _amount(parameter: Parameter) -> str:
    varied = f"{parameter.name} ± {amount(parameter.tolerance, parameter.unit, digits=6)}"
    return f"{varied} ({parameter.tolerance_means})"
