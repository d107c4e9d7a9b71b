"""`nolens calibrate plan` and `stitch`: PSFs captured at angles become one beyond the sensor."""

from functools import partial
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator
from torch import Tensor

from nolens.calibrate.stitch import Capture, CapturePlan, locate, stitch
from nolens.camera import PsfEntry
from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.files import read_camera, read_psf, read_psf_set, readable
from nolens.jobs.calibration.folder import (
    FolderOptions,
    Reduced,
    added,
    folder_layers,
    made_of,
    psf_folder,
)
from nolens.jobs.fields import CAMERAS, FilePath, FullAngle, Name
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Length

_REDUCED_FRACTION = 0.15
"""How far a reduced thickness alone may put a PSF off its place; at 37° it is 11 %."""
_PLAN = "nolens calibrate plan CAMERA --angle 56deg lists the angles for a scene of 56°"


def _one_or_two(value: Any) -> Any:
    """Width and height of "56deg,42deg", or twice the same."""
    if not isinstance(value, str):
        return value
    parts = value.split(",")
    if len(parts) > 2:
        raise refusal(
            "give the angle that the scene fills, or width and height: 56deg or 56deg,42deg"
        )
    return parts[0], parts[-1]


class CalibratePlanOptions(JobOptions):
    """List the angles at which to capture PSFs for nolens calibrate stitch.

    nolens calibrate plan paper --angle 56deg
    """

    usage = "calibrate plan CAMERA --angle 56deg"

    camera: Annotated[
        Name,
        Option(f"{CAMERAS}.", role="camera", positional=True),
    ] = "paper"
    angle: Annotated[
        tuple[FullAngle, FullAngle],
        BeforeValidator(_one_or_two),
        Option(
            "Which angle the scene fills, or its width and height, such as 56deg,42deg.",
            needed="the angle that the scene fills (--angle 56deg, or width and height: --angle "
            "56deg,42deg)",
        ),
    ]


@job
def calibrate_plan(run: Run[CalibratePlanOptions]) -> Product[list[tuple[float, float]]]:
    """List the angles at which a point source must be captured for a scene of some width.

    Raises
    ------
    NolensError
        If the camera or an option cannot be used.
    """
    loaded = read_camera(run.options.camera)
    plan = CapturePlan.of_scene(loaded.camera, run.options.angle)
    figures = {
        "camera": loaded.camera.name,
        "angles_deg": [[right, up] for right, up in plan.angles_deg],
        "corner_deg": round(plan.corner_deg, 2),
        "sensor_pixels": list(plan.sensor),
        "support": list(plan.support),
        "pixels": [plan.sensor[0] + plan.support[0], plan.sensor[1] + plan.support[1]],
    }
    return Product(plan.angles_deg, figures)


class CalibrateStitchOptions(FolderOptions):
    """Merge PSFs that were captured at several angles into an extended one, beyond the sensor.

    nolens calibrate stitch mycamera

    nolens reconstruct raw.dng --psf mycamera/stitched-300mm.tif --psf-extent wide --support 414x414

    A camera without an aperture sees light through mask that the PSF from straight ahead does
    not show. Point sources from the side move the PSF, so that the sensor sees its other
    parts: nolens calibrate plan lists the angles. They need be right to 3° only: each PSF is
    placed by what it has in common with the others.
    """

    names: ClassVar = ("stitched", "stitch")
    usage = "calibrate stitch FOLDER"

    folder: Annotated[
        FilePath,
        psf_folder(
            "Of the camera's PSFs, as nolens calibrate makes it, with one from straight ahead and "
            "others at angles (--angle)."
        ),
    ]
    distance: Annotated[
        Depth | None,
        Option("Of the point sources.", default="the only one that was captured at angles"),
    ] = None
    reduced: Reduced = None


def _entries(
    options: CalibrateStitchOptions, captured: list[PsfEntry]
) -> tuple[list[PsfEntry], int]:
    """The PSFs to stitch, and the number of the one from straight ahead."""
    distance = options.distance
    entries = [each for each in captured if each.distance == distance]
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
            f"{str(distance).replace(' ', '')} -o {options.folder}"
        )
    if len(entries) == 1:
        raise DataError(
            f"{options.folder} has only the PSF of a light straight ahead at {distance}: capture "
            f"others at angles (nolens calibrate FRAME... --angle 28deg,0deg). {_PLAN}"
        )
    for each in entries:
        if not each.on_axis and each.frame != "sensor":
            raise DataError(
                f"{each.file} was moved to the middle, and what the sensor captured at its edges "
                "is lost: calibrate its frames again, so that it stays as captured (frame = "
                '"sensor")'
            )
    return entries, ahead[0]


def _distance(
    options: CalibrateStitchOptions, captured: list[PsfEntry]
) -> Length | Literal["infinity"]:
    """The only distance with lights from the side."""
    aside = {each.distance for each in captured if not each.on_axis}
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
    return aside.pop()


@job
def calibrate_stitch(run: Run[CalibrateStitchOptions]) -> Product[Tensor]:
    """Register the captured PSFs of one distance, merge them, and add the result to their folder.

    Raises
    ------
    NolensError
        If the folder or an option cannot be used; then nothing is written.
    """
    reporter = run.reporter
    psfs = read_psf_set(run.options.folder).psf
    captured = [each for each in psfs if each.kind == "captured"]
    distance = run.options.distance or _distance(run.options, captured)
    options = run.options = run.options.model_copy(update={"distance": distance})
    entries, ahead = _entries(options, captured)
    layers, camera = folder_layers(options.folder, options.reduced)
    run.reads({f"PSF {each.file}": options.folder / each.file for each in entries})
    run.reads(camera)
    inexact = 0.0 if camera else _REDUCED_FRACTION
    captures = [
        Capture.at_angle(
            read_psf(options.folder, each),
            each.angle,
            layers,
            each.pixel.um,
            name=each.file,
            inexact=inexact,
        )
        for each in entries
    ]
    run.begin()
    placement = locate(captures, ahead, partial(reporter.advance, "overlaps"))
    stitched = stitch(captures, placement, ahead, partial(reporter.advance, "merging"))
    usable = [each.usable_per_mm for each in entries if each.usable_per_mm is not None]
    entry = made_of(
        entries[0], options.psf_file, "stitched", usable_per_mm=min(usable, default=None)
    )
    run.warn(*stitched.warnings())
    figures = {
        "folder": readable(options.folder),
        "distance": str(distance),
        "file": entry.file,
        **stitched.figures(),
    }
    return added(stitched.psf, figures, options.folder, {entry: stitched.psf})
