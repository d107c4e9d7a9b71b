"""The tolerance budget of a process sheet, from a study of tolerances."""

from pathlib import Path

from nolens.camera import Camera
from nolens.errors import DataError
from nolens.fabricate import ToleranceBudget, ToleranceLine, poured_layer
from nolens.files import read_record

_MM = {"nm": 1e-6, "um": 1e-3, "mm": 1.0}


def study_budget(path: Path, camera: Camera) -> ToleranceBudget:
    """Read the budget that `nolens design tolerance` found for a camera.

    Parameters
    ----------
    path
        Its record.
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
    lines = tuple(ToleranceLine(**line) for line in result["budget"])
    share = f"; {100 * result['yield']['share']:.3g} % meet the limit" if "yield" in result else ""
    method = (
        f"From nolens design tolerance: {result['criterion']} by {result['model']}, "
        f"{result['trials']} cameras drawn{share}. What is allowed was assumed there: 2σ of "
        "a normal distribution, the farthest value of another."
    )
    thickness = f"{poured_layer(camera).name}.thickness"
    layer_mm = next(
        (line.allowed * _MM[line.unit] for line in lines if line.parameter == thickness), None
    )
    return ToleranceBudget(lines, method, layer_mm)
