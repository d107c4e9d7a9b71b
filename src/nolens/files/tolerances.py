"""Tolerances that a person wrote down, and the cameras that were drawn from them."""

import csv
from pathlib import Path

from nolens.camera import Camera
from nolens.design.tolerances import Parameter, Study, parameters_from_toml
from nolens.files.input import read_text


def read_tolerances(path: str | Path, camera: Camera) -> tuple[Parameter, ...]:
    """Read the tolerances of a camera.

    Parameters
    ----------
    path
        A .toml file as ``nolens design tolerance CAMERA --show`` prints it.
    camera
        The camera that they are for.

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
    """Write all cameras that were drawn, as CSV: number, parameters, criterion.

    Parameters
    ----------
    path
        To be written.
    study
        Has the cameras.
    """
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
