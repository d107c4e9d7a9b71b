"""`nolens calibrate plan` and `stitch`: PSFs captured at angles become one beyond the sensor."""

from functools import partial
from typing import Annotated, Any, ClassVar

from pydantic import BeforeValidator
from torch import Tensor

from nolens.calibrate.capture_plan import PLANS, CapturePlan
from nolens.calibrate.stitch import Capture, Stitched, stitch_at_angles
from nolens.camera import LoadedCamera, PsfEntry
from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.experiments.between_angles import MOST_PIXELS, errors_between
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import read_camera, read_psf, readable
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import FolderOptions, Reduced, added, place_name, psf_folder
from nolens.jobs.fields import CAMERAS, FilePath, Fraction, FullAngle, Name
from nolens.jobs.options import JobOptions, Option
from nolens.jobs.run import Product, Run, job
from nolens.quantities import Percentage
from nolens.twin import Light, Twin

_REDUCED_FRACTION = 0.15
"""How far a reduced thickness alone may put a PSF off its place; at 37° it is 11 %."""


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

    PSFs at angles in between are interpolated. --error says by how much of their contrast these
    may be off, and takes the fewest angles with which they are not; it computes PSFs of the camera.
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
    error: Annotated[
        Fraction | None,
        Option(
            "How far PSFs between the angles may be off, such as 10%.",
            default="not computed: nine angles, or five for scenes of up to 40 deg",
        ),
    ] = None


@job
def calibrate_plan(run: Run[CalibratePlanOptions]) -> Product[list[tuple[float, float]]]:
    """List the angles at which a point source must be captured for a scene of some width.

    Raises
    ------
    NolensError
        If the camera or an option cannot be used, or PSFs of the most angles are farther off.
    """
    loaded, angle = read_camera(run.options.camera), run.options.angle
    if run.options.error is None:
        plan, errors = CapturePlan.of_scene(loaded.camera, angle), dict[str, float]()
    else:
        plan, errors = _plan_by_error(run, loaded, run.options.error)
    return Product(
        plan.angles_deg, {"camera": loaded.camera.name, **plan.figures(), "errors": errors}
    )


def _plan_by_error(
    run: Run[CalibratePlanOptions], loaded: LoadedCamera, allowed: Percentage
) -> tuple[CapturePlan, dict[str, float]]:
    """The plan of the fewest angles, and the errors of all that were tried, by number of angles."""
    camera = loaded.camera
    plans = [CapturePlan.of_scene(camera, run.options.angle, count) for count in PLANS]
    rows, columns = (
        min(most, count)
        for most, count in zip(
            MOST_PIXELS, (camera.sensor.rows, camera.sensor.columns), strict=True
        )
    )
    run.begin()
    experiment = VirtualExperiment(Twin.of(loaded).reading(rows, columns), Light("white-led"))
    errors: dict[str, float] = {}
    found = errors_between(experiment, plans, partial(run.reporter.advance, "PSFs"))
    for plan, error in zip(plans, found, strict=True):
        errors[str(len(plan.angles_deg))] = error
        if error <= allowed.value:
            return plan, errors
    tried = ", ".join(f"{100 * error:.2g} % by {count}" for count, error in errors.items())
    raise OptionError(
        f"PSFs between the angles would be off by more than {allowed} with all plans there are: "
        f"{tried} angles. Allow more (--error), or choose a smaller angle"
    )


class CalibrateStitchOptions(FolderOptions):
    """Merge PSFs that were captured at several angles into an extended one, beyond the sensor.

    nolens calibrate stitch mycamera

    nolens reconstruct raw.dng --psf mycamera --support 414x414

    A camera without an aperture sees light through parts of the mask that the PSF from straight
    ahead does not show. Point sources from the side move the PSF, so that the sensor sees its
    other parts: nolens calibrate plan lists the angles. They need to be right only to within 3°:
    each PSF is placed by its overlap with the others. Where the folder has a camera.toml, a PSF of
    each angle is written too, which reconstruct --psf FOLDER uses over the field.
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


@job
def calibrate_stitch(run: Run[CalibrateStitchOptions]) -> Product[Tensor]:
    """Register the captured PSFs of one distance, merge them, and add the result to their folder.

    Raises
    ------
    NolensError
        If the folder or an option cannot be used; then nothing is written.
    """
    options, advance = run.options, run.reporter.advance
    folder = PsfFolder(options.folder)
    entries = folder.at_angles(options.distance)
    distance = entries[0].distance
    options = run.options = options.model_copy(update={"distance": distance})
    layers = folder.layers(options.reduced)
    run.reads({f"PSF {each.file}": options.folder / each.file for each in entries})
    run.reads(folder.camera_files)
    inexact = 0.0 if folder.camera else _REDUCED_FRACTION
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
    stitched = stitch_at_angles(captures, partial(advance, "overlaps"), partial(advance, "merging"))
    usable = [each.usable_per_mm for each in entries if each.usable_per_mm is not None]
    entry = entries[0].derived(
        options.psf_file, "stitched", usable_per_mm=min(usable, default=None)
    )
    run.warn(*stitched.warnings())
    made = {entry: stitched.psf, **_over_field(entries, entry, stitched, folder)}
    figures = {
        "folder": readable(options.folder),
        "distance": str(distance),
        "file": entry.file,
        "field_points": len(made) - 1,
        "megabytes": round(len(made) * 4e-6 * stitched.psf.numel(), 1),
        **stitched.figures(),
    }
    return added(stitched.psf, figures, options.folder, made)


def _over_field(
    captured: list[PsfEntry], merged: PsfEntry, stitched: Stitched, folder: PsfFolder
) -> dict[PsfEntry, Tensor]:
    """A PSF of each angle; none without a camera, as their places need its layers.

    Their files are named after the stated angles, and so replaced when captures are stitched again.
    """
    if folder.camera is None:
        return {}
    layers = folder.layers(None)
    return {
        merged.model_copy(
            update={
                "file": f"field-point-{place_name(each.distance, each.angle)}.tif",
                "kind": "field-point",
                "angle": stitched.angle(number, layers),
                "usable_per_mm": each.usable_per_mm,
            }
        ): psf
        for number, (each, psf) in enumerate(zip(captured, stitched.at_captures(), strict=True))
    }
