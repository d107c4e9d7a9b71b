"""Which PSFs of a folder are stitched, and where their angles put them."""

from collections import Counter
from dataclasses import dataclass
from typing import Literal

from nolens.calibrate.distances import Layers
from nolens.camera import PsfEntry, PsfSet
from nolens.errors import DataError, OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.calibration.folder import folder_camera
from nolens.jobs.calibration.stitch_options import CalibrateStitchOptions
from nolens.quantities import Length

_REDUCED_SHARE = 0.15
"""How far a reduced thickness alone may put a pattern off its place; at 37° it is 11 %."""
_PLAN = "nolens calibrate plan CAMERA --angle 56deg lists the angles for a scene of 56°"


@dataclass(frozen=True)
class Captured:
    """PSFs that were captured of lights at one distance.

    Parameters
    ----------
    entries
        As the folder lists them.
    reference
        Number of the one from straight ahead.
    distance
        Of the lights.
    """

    entries: tuple[PsfEntry, ...]
    reference: int
    distance: Length | Literal["infinity"]


def chosen(options: CalibrateStitchOptions, psfs: PsfSet) -> Captured:
    """The PSFs to stitch.

    Raises
    ------
    OptionError
        If it is not clear which distance is meant.
    DataError
        If there are too few of it, or they cannot be stitched.
    """
    captured = [each for each in psfs.psf if each.kind == "captured"]
    distance = options.distance or _distance(options, captured)
    entries = tuple(each for each in captured if each.distance == distance)
    if not entries:
        have = ", ".join(sorted({str(each.distance) for each in captured})) or "no distance"
        raise OptionError(
            f"--distance {distance}: {options.folder} has captured PSFs of {have}; choose one"
        )
    ahead = [number for number, each in enumerate(entries) if each.on_axis]
    if not ahead:
        raise DataError(
            f"{options.folder} has no captured PSF of a light straight ahead at {distance}, which "
            "all others are laid on: add it with nolens calibrate FRAME... --distance "
            f"{_joined(distance)} -o {options.folder}"
        )
    if len(entries) == 1:
        raise DataError(
            f"{options.folder} has only the PSF of a light straight ahead at {distance}: capture "
            f"others at angles (nolens calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
        )
    for each in entries:
        if not each.on_axis and each.frame != "sensor":
            raise DataError(
                f"{each.file} was moved to the middle, and what the sensor saw at its edges is "
                "lost: calibrate its frames again, so that it stays as captured (frame = "
                '"sensor")'
            )
    return Captured(entries, ahead[0], distance)


def stack_of(options: CalibrateStitchOptions) -> tuple[Layers, float]:
    """The layers, and the share by which they may put a pattern off.

    Raises
    ------
    OptionError
        If nothing says how far an angle moves the pattern, or two do.
    """
    opened = folder_camera(options.folder)
    if opened is not None and options.reduced is not None:
        raise OptionError(
            f"--reduced {options.reduced}: the folder has a {CAMERA_FILE}, whose layers say the "
            "same. Leave --reduced out, or mend the layers"
        )
    if opened is not None:
        return Layers.of_camera(opened.camera), 0.0
    if options.reduced is None:
        raise OptionError(
            f"the folder has no {CAMERA_FILE}: give the reduced thickness between mask and sensor, "
            "the sum of thickness / index of all layers (--reduced 1.28mm)"
        )
    return Layers.of_air(options.reduced.um), _REDUCED_SHARE


def _distance(
    options: CalibrateStitchOptions, captured: list[PsfEntry]
) -> Length | Literal["infinity"]:
    """The only distance with lights from the side."""
    aside = Counter(each.distance for each in captured if not each.on_axis)
    if not aside:
        raise DataError(
            f"{options.folder} has no captured PSF of a light from the side: add some (nolens "
            f"calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
        )
    if len(aside) > 1:
        have = ", ".join(sorted(str(each) for each in aside))
        raise OptionError(
            f"{options.folder} has PSFs at angles of several distances ({have}): say which "
            "(--distance)"
        )
    return next(iter(aside))


def _joined(distance: Length | Literal["infinity"]) -> str:
    return str(distance).replace(" ", "")
