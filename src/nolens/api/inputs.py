"""Arguments of the front door's functions, as the packages below take them; their progress."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from nolens.api.image import Image
from nolens.camera import Frame, linear_from_srgb
from nolens.errors import DataError, OptionError
from nolens.files import read_frame, read_picture, write_frame
from nolens.jobs.run import Reporter
from nolens.optics import PointSource
from nolens.quantities import Angle, Length
from nolens.solvers.inputs import Plane, channels_of

Raw = str | Path | Frame | Image | Plane
"""A file, a frame, a picture of ours, or linear values (channels, height, width)."""
Scene = str | Path | Image | Plane
"""A picture's file, 8 or 16-bit sRGB (height, width, 3), or linear values, channels first."""

Progress = bool | Callable[[float], object]
"""False is silent, True draws a bar; a function is called with the fraction that is done."""

_NAMES = {1: ("grey",), 3: ("R", "G", "B")}
_WHITE = {"uint8": 255.0, "uint16": 65535.0}
_CHANNELS = (1, 3)
_WITH_ROLE = ("PSF", "dark frame", "flat field")
"""What messages name with its role before its source."""


def load(path: str | Path, *, mosaic: str | None = None, bgr: bool = False) -> Frame:
    """Read a raw frame: the stored counts, and what the file says about them.

    Parameters
    ----------
    path
        Camera raw, TIFF, PNG or npy.
    mosaic
        Colour mosaic of a TIFF, PNG or npy that holds raw counts, such as ``"RGGB"``.
    bgr
        Whether the file's channels are in the order B, G, R.

    Raises
    ------
    FileError
        If the file cannot be read.
    """
    return read_frame(path, mosaic=mosaic, bgr=bgr)


def save_frame(frame: Frame, path: str | Path) -> Path:
    """Write a raw frame so that `load` gives the same counts again: .dng, .tif or .npy.

    Parameters
    ----------
    frame
        Of `load` or of a simulated camera.
    path
        A .dng holds whole counts of a colour mosaic; a .npy nothing but the counts.

    Raises
    ------
    OptionError
        If the file's kind cannot hold such a frame.
    FileError
        If the file cannot be written.
    """
    write_frame(path, frame)
    return Path(path)


def frame_of(value: Raw, what: str) -> Frame:
    """A frame of whatever holds one; values without a file have their black level subtracted.

    Parameters
    ----------
    value
        See `Raw`.
    what
        For messages, such as "measurement".

    Raises
    ------
    FileError
        If a file cannot be read.
    DataError
        If an array is no picture.
    """
    if isinstance(value, Frame):
        return value
    if isinstance(value, (str, Path)):
        return read_frame(value)
    if isinstance(value, Image):
        values, names = value.values.cpu(), value.channels
    else:
        values = channels_of(value, what).float()
        if values.shape[0] not in _NAMES:
            raise DataError(
                f"the {what} has {values.shape[0]} channels; give 1 (grey) or 3 (R, G, B), "
                "(channels, height, width)"
            )
        names = _NAMES[values.shape[0]]
    # Messages say "the PSF psf.tif", "the dark frame dark.tif", and of a measurement "raw.tif".
    of_role = next((role for role in _WITH_ROLE if what.startswith(role)), None)
    source = f"the {what}" if of_role is None else f"array{what.removeprefix(of_role)}"
    return Frame(values, names, None, (0.0,), None, "float32", source, black_stated=True)


def radiance_of(scene: Scene) -> tuple[Tensor, Tensor | None]:
    """Linear radiance (3, height, width) of a scene, 1 is white, and its opacity.

    Raises
    ------
    FileError
        If a file cannot be read.
    DataError
        If an array is no picture.
    """
    if isinstance(scene, (str, Path)):
        picture = read_picture(scene)
        return picture.radiance, picture.opacity
    if isinstance(scene, Image):
        return _in_colour(scene.values.cpu()), None
    array: Any = scene if isinstance(scene, Tensor) else np.asarray(scene)
    name = str(array.dtype).removeprefix("torch.")
    if name in _WHITE:
        return _of_srgb(np.asarray(array), _WHITE[name]), None
    return _in_colour(channels_of(scene, "scene").float()), None


def source_of(
    distance: str | Length, angle: tuple[str | Angle, str | Angle], diameter: str | Length
) -> PointSource:
    """A point source at a distance and field angles, to the right and up.

    Raises
    ------
    OptionError
        If a quantity has no unit, or another one.
    """
    right, up = (math.tan(angle_of(each).rad) for each in angle)
    depth = distance_um(distance)
    return PointSource((-up, right), depth, 0.0 if math.isinf(depth) else length_um(diameter))


def angle_of(value: str | Angle) -> Angle:
    """An angle such as ``"20deg"``.

    Raises
    ------
    OptionError
        If it has no unit, or is none.
    """
    return value if isinstance(value, Angle) else Angle.parse(value)


def length_um(value: str | Length) -> float:
    """A length such as ``"3.1um"`` in µm.

    Raises
    ------
    OptionError
        If it has no unit, or is none.
    """
    return (value if isinstance(value, Length) else Length.parse(value)).um


def distance_um(distance: str | Length) -> float:
    """A distance such as ``"300mm"``, or ``"infinity"``, in µm.

    Raises
    ------
    OptionError
        If it is neither, or not above 0.
    """
    if distance == "infinity":
        return math.inf
    value = length_um(distance)
    if not value > 0:
        raise OptionError(f"distance is {distance}; give one above 0, such as 300mm, or infinity")
    return value


def _of_srgb(array: NDArray[Any], white: float) -> Tensor:
    if array.ndim == 3 and array.shape[0] in _CHANNELS and array.shape[2] not in _CHANNELS:
        array = np.moveaxis(array, 0, -1)
    if array.ndim == 2:
        array = array[..., None]
    if array.ndim != 3 or array.shape[2] not in _CHANNELS:
        raise DataError(
            f"the scene is {array.shape}; give (height, width, 3) or (height, width) of sRGB"
        )
    planes = torch.from_numpy(np.moveaxis(array, -1, 0).astype(np.float32))
    return _in_colour(linear_from_srgb(planes / white))


def _in_colour(values: Tensor) -> Tensor:
    if values.shape[0] not in _CHANNELS:
        raise DataError(f"the scene has {values.shape[0]} channels; give 1 (grey) or 3 (R, G, B)")
    return values.expand(3, -1, -1)


@contextmanager
def reported(progress: Progress, what: str) -> Iterator[Callable[[float], None]]:
    """A function for the fraction that is done, which shows it as was asked for.

    Parameters
    ----------
    progress
        What was asked for.
    what
        Beside the bar.
    """
    if progress is True:
        from rich.progress import Progress as Bar

        with Bar(transient=True) as bar:
            task = bar.add_task(what, total=1.0)
            yield lambda done: bar.update(task, completed=done)
        return
    call = progress

    def call_back(done: float) -> None:
        if callable(call):
            call(done)

    yield call_back


class CallbackReporter(Reporter):
    """Passes on what fraction of a job is done, and keeps its notes.

    Parameters
    ----------
    report
        Is called with the fraction.
    """

    def __init__(self, report: Callable[[float], None]) -> None:
        self.notes: list[str] = []
        self._report = report

    def note(self, text: str) -> None:
        """Keep it."""
        self.notes.append(text)

    def advance(self, what: str, fraction: float) -> None:
        """Pass it on."""
        self._report(fraction)

    def step(self, what: str, done: int, limit: int, result: str, state: str = "") -> bool:
        """Pass on the fraction."""
        self.advance(what, done / limit)
        return False
