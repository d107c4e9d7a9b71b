"""Files that a camera takes along into another folder."""

import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

from nolens.camera import CurveFile, OpenCamera, ReliefFile
from nolens.files import CAMERA_FILE, camera_files
from nolens.files.cameras import write_description


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


def copied_camera(given: str, opened: OpenCamera) -> dict[str, Callable[[Path], None]]:
    """What copies a camera into a folder where something else is written: for each file, a writer.

    Parameters
    ----------
    given
        What the camera was read from.
    opened
        The camera.
    """
    camera, files = opened.camera, camera_files(given, opened.camera)
    writers = {CAMERA_FILE: partial(write_description, camera=camera)}
    if isinstance(camera.mask.relief, ReliefFile):
        name = camera.mask.relief.file
        writers[name] = partial(_copy, files[f"camera's {name}"])
    return {**writers, **copied_curves(given, opened)}


def _copy(source: Path, path: Path) -> None:
    shutil.copyfile(source, path)
