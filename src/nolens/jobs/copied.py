"""Files that a camera takes along into another folder."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from nolens.camera import CurveFile, OpenCamera
from nolens.files import camera_files


def copied_curves(given: str, opened: OpenCamera) -> dict[str, Callable[[Path], None]]:
    """What copies the curves that a camera names: for each file, a writer for `write_camera`.

    Parameters
    ----------
    given
        What the camera was read from.
    opened
        The camera.
    """
    sensor = opened.camera.sensor
    files = camera_files(given, opened.camera)
    return {
        curve.file: partial(_copy, files[f"camera's {curve.file}"])
        for curve in (sensor.quantum_efficiency, sensor.acceptance)
        if isinstance(curve, CurveFile)
    }


def _copy(source: Path, path: Path) -> None:
    shutil.copyfile(source, path)
