"""`nolens measure field`: how PSFs and a grid of dots change with the field angle."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field

from nolens.amounts import rounded
from nolens.camera import LoadedCamera, develop
from nolens.camera.part import PositiveLength, refusal
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.evaluate import clipped_pixels
from nolens.experiments.dot_grid import locate_grid
from nolens.experiments.off_axis import (
    CORRELATIONS,
    FieldOfView,
    FieldTarget,
    captured_at_angles,
    compare,
    source_of,
)
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import (
    PSFS_FILE,
    read_frame,
    read_psf,
    read_psf_set,
    write_png,
    write_tiff32,
)
from nolens.files.plot_measurements import write_field_plot
from nolens.jobs.fields import CAMERAS, FilePath, Name, RecordedOptions, Seed
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, Writer, job
from nolens.quantities import Angle, Length
from nolens.ranges import Between
from nolens.solvers import Prior
from nolens.twin import Light, distance_um, preview_model

_REMEDY = "a camera with fewer pixels or a coarser grid of its relief needs less"
_REMEDY_OF_PSFS = "fewer PSFs (--field-points) or a camera with fewer pixels need less"


_OPTIONS = {
    "PSFS": ("psfs", "camera", "plot"),
    "--dots": ("dots", "dot_pitch", "distance", "extent", "camera", "plot"),
    "--simulate": (
        "simulate",
        "angles",
        "dot_pitch",
        "distance",
        "extent",
        "field_points",
        "simulated_psfs",
        "prior",
        "seed",
        "plot",
        "output",
    ),
}
_OF_DOTS = ("extent", "field_points", "simulated_psfs", "prior", "output")
_LIGHT = "Light and grid of dots"
_OffAxis = Annotated[Angle, Between("0 deg", "89.9 deg")]


def _angles(value: Any) -> Any:
    return value.split(",") if isinstance(value, str) else value


def _rising(angles: tuple[Angle, ...]) -> tuple[Angle, ...]:
    degrees = [angle.deg for angle in angles]
    if degrees != sorted(set(degrees)) or not degrees:
        raise refusal("give rising angles from 0deg on, such as 0deg,10deg,20deg")
    return angles


class MeasureFieldOptions(RecordedOptions):
    """Measure how far to the side a camera sees.

    nolens measure field mycamera --plot field.png

    nolens measure field --simulate paper --angles 0deg,10deg,20deg,30deg,40deg,50deg

    nolens measure field --dots dots.tif --dot-pitch 20mm --distance 300mm --camera mycamera

    nolens measure field --simulate paper --dot-pitch 20mm -o dots.tif

    The first two compare PSFs from the side with the central one, as the paper's Fig. 6c does:
    by the correlation of the frames, each by its own norm; where exposures are known, at one
    exposure by the central norm, so that lost light counts; and over their overlap alone. The
    others find every dot of a grid in its picture, as in Fig. 6d: where it is by Snell's law,
    how wide, how bright; good, distorted or lost. All angles are half angles.
    """

    usage = "measure field FOLDER, --simulate CAMERA, or --dots PICTURE"

    psfs: Annotated[
        FilePath | None,
        Option(
            "Folder with PSFs captured at angles (nolens calibrate).",
            role="input",
            positional=True,
            label="PSFs of",
        ),
    ] = None
    simulate: Annotated[
        Name | None,
        Option(
            f"Camera to simulate: {CAMERAS}.",
            role="camera",
            label="Camera",
        ),
    ] = None
    dots: Annotated[
        FilePath | None,
        Option(
            "Reconstructed picture of a grid of dots, its middle scene pixel on the camera's axis, "
            "as nolens reconstruct --support writes it: float .tif.",
            role="input",
            label="Picture",
        ),
    ] = None
    camera: Annotated[
        Name | None,
        Option(
            "Camera that the PSFs or the picture are from.",
            default="camera.toml beside the PSFs; for a picture paper",
            role="camera",
            label="Camera",
        ),
    ] = None
    angles: Annotated[
        tuple[_OffAxis, ...],
        BeforeValidator(_angles),
        Field(max_length=100),
        AfterValidator(_rising),
        Option(
            "Half angles of the simulated point sources, rising, with commas between them.",
            default="0deg,5deg, and so on to 50deg",
            label="Half angles",
        ),
    ] = tuple(Angle(str(5 * number), "deg") for number in range(11))
    dot_pitch: Annotated[
        PositiveLength | None,
        Option(
            "Distance of neighbouring dots; with --simulate, a grid is shown to the camera.",
            label="Distance of the dots",
        ),
    ] = None
    distance: Annotated[
        Depth | None,
        Option(
            "Distance of the grid or of the point sources from the camera, such as 300mm; of these "
            "also infinity.",
            default="with --simulate the camera's reference_distance",
            label="Distance of the grid",
        ),
    ] = None
    extent: Annotated[
        Angle,
        Between("0.1 deg", "89.9 deg"),
        Option(
            "Half angle up to which there are dots.",
            label="Half angle with dots",
            former="reach",
        ),
    ] = Angle("50", "deg")
    field_points: Annotated[
        int,
        Between(1, 101),
        Option(
            "PSFs along each side of the field with which the simulated grid is reconstructed, an "
            "odd number; 1 takes the one straight ahead for all of it.",
            _LIGHT,
        ),
    ] = 1
    simulated_psfs: Annotated[
        int | None,
        Between(1, 101),
        Option(
            "PSFs along each side of the field between which those of the simulated grid are "
            "blended, an odd number.",
            _LIGHT,
            default="one every 12.5deg",
        ),
    ] = None
    prior: Annotated[
        Prior,
        Option(
            "What the reconstruction of the simulated grid assumes: auto as for any scene, l1 for "
            "points in the dark.",
            _LIGHT,
        ),
    ] = Prior.AUTO
    seed: Annotated[Seed, Option("Of the simulated noise.", _LIGHT)] = 0
    plot: Annotated[
        FilePath | None,
        Option(
            "Plot to write (.png). The record of the run goes beside it, as .json.",
            role="output",
            suffixes=(".png",),
        ),
    ] = None
    output: Annotated[
        FilePath | None,
        Option(
            "Picture of the simulated grid: .png, or .tif (linear floats) that --dots reads.",
            role="output",
            what="picture",
            suffixes=(".png", ".tif", ".tiff"),
            flag="-o",
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse all but one thing to measure, and options that say nothing of it."""
        named = {"PSFS": self.psfs, "--simulate": self.simulate, "--dots": self.dots}
        sources = [name for name, value in named.items() if value is not None]
        if len(sources) != 1:
            what = "nothing is" if not sources else f"{' and '.join(sources)} are"
            raise OptionError(
                f"{what} given to measure: give one of a folder of PSFs, --simulate CAMERA, or "
                "--dots PICTURE"
            )
        source = sources[0]
        names = [name for name in type(self).model_fields if name in self.model_fields_set]
        for name in names:
            if name not in _OPTIONS[source]:
                raise OptionError(f"{self.flag(name)} means nothing with {source}: leave it out")
        grid = self.dots is not None or self.dot_pitch is not None
        for name in _OF_DOTS:
            if not grid and name in names:
                raise OptionError(
                    f"{self.flag(name)} is about a grid of dots: give --dot-pitch too"
                )
        if grid and "angles" in names:
            raise OptionError(
                "--angles and --dot-pitch are two things to measure: give one of them at a time"
            )
        if self.dots is not None:
            missing = [each for each in ("dot_pitch", "distance") if getattr(self, each) is None]
            if missing:
                raise OptionError(
                    f"{self.dots} is a grid of dots of unknown size: give "
                    + " and ".join(map(self.flag, missing))
                    + ", such as --dot-pitch 20mm --distance 300mm"
                )
        if grid and self.distance is not None and not isinstance(self.distance, Length):
            raise OptionError("--distance infinity: a grid of dots needs one, such as 300mm")

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the camera's."""
        if self.psfs is not None:
            return {"PSFs": self.psfs / PSFS_FILE}
        return {} if self.dots is None else {"picture": self.dots}


@job
def measure_field(run: Run[MeasureFieldOptions]) -> Product[FieldOfView]:
    """Measure the field of view, and write the plot and picture that are asked for.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used, or a target is not what it was said to
        be; then nothing is written.
    """
    options = run.options
    name = options.simulate or options.camera
    if options.psfs is None:
        name = name or "paper"
    loaded = run.camera_beside(name, options.psfs)
    if options.psfs is not None or loaded is None:
        product = _of_folder(run, loaded)
    elif options.dots is not None:
        product = _of_picture(run, loaded)
    else:
        product = _of_twin(run, loaded)
    camera = None if loaded is None else loaded.camera.name
    return replace(product, figures={**product.figures, "camera": camera})


def _of_picture(run: Run[MeasureFieldOptions], loaded: LoadedCamera) -> Product[FieldOfView]:
    options = run.options
    assert options.dots is not None and options.dot_pitch is not None
    frame = read_frame(options.dots)
    if frame.mosaic is not None:
        raise OptionError(
            f"{options.dots} is a raw file: reconstruct it first (nolens reconstruct), and give "
            "the picture as .tif"
        )
    picture = develop(frame, channels="all" if len(frame.channels) == 1 else "grey").values[0]
    run.begin()
    assert isinstance(options.distance, Length)
    grid = locate_grid(
        picture,
        preview_model(loaded),
        pitch_um=options.dot_pitch.um,
        distance_um=options.distance.um,
        extent_deg=options.extent.deg,
    )
    return _product(options, FieldOfView((), grid))


def _of_folder(run: Run[MeasureFieldOptions], loaded: LoadedCamera | None) -> Product[FieldOfView]:
    folder = run.options.psfs
    assert folder is not None
    twin = None if loaded is None else preview_model(loaded)
    central, others = captured_at_angles(folder, read_psf_set(folder).psf)
    first = read_psf(folder, central).mean(dim=0)
    if twin is not None and not math.isclose(central.pixel.um, twin.pixel_um, rel_tol=0.01):
        raise DataError(
            f"{central.file} has pixels of {central.pixel}, but a reconstruction with the camera "
            f"{twin.camera.name!r} has pixels of {twin.pixel_um:g} µm: give the camera that the "
            "PSFs are from (--camera)"
        )
    psfs = []
    for number, entry in enumerate(others):
        run.reporter.advance("PSFs", number / len(others))
        psf = first if entry is central else read_psf(folder, entry).mean(dim=0)
        clipped = clipped_pixels(psf)
        if clipped:
            run.warn(
                f"{clipped} pixels of {folder / entry.file}, many side by side, have its very "
                "largest value: it seems to be clipped. Take a shorter exposure"
            )
        psfs.append(compare(first, psf, source_of(entry), central.pixel.um, twin))
    depth_um = central.distance_um
    return _product(run.options, FieldOfView.of_psfs(psfs, twin, depth_um), depth_um)


def _of_twin(run: Run[MeasureFieldOptions], loaded: LoadedCamera) -> Product[FieldOfView]:
    options, distance = run.options, distance_um(run.options.distance, loaded)
    target = FieldTarget(
        distance,
        [angle.deg for angle in options.angles],
        None if options.dot_pitch is None else options.dot_pitch.um,
        options.extent.deg,
        options.field_points,
        options.prior,
        options.simulated_psfs,
    )
    working = target.working_bytes(preview_model(loaded))
    several = target.pitch_um is not None and target.psf_points > 1
    twin = run.twin(loaded, working, _REMEDY_OF_PSFS if several else _REMEDY)
    experiment = VirtualExperiment(twin, Light("white-led"), field_points=target.field_points)
    field = target.measure(experiment, options.seed, partial(run.reporter.advance, str(target)))
    if field.grid is not None:
        run.warn(*field.grid.warnings)
    return _product(options, field, distance)


def _product(
    options: MeasureFieldOptions, field: FieldOfView, distance: float | None = None
) -> Product[FieldOfView]:
    """The figures, the plot and the picture; the distance is that of the light or the grid."""
    figures = rounded(field.figures)
    if distance is not None:
        distance_mm = None if math.isinf(distance) else distance * 1e-3
        figures = {"distance_mm": distance_mm, **figures}
    writers: dict[Path, Writer] = {}
    if options.plot is not None:
        writers[options.plot] = partial(write_field_plot, field=field, levels=CORRELATIONS)
    if options.output is not None and field.grid is not None:
        write = write_png if options.output.suffix.lower() == ".png" else write_tiff32
        writers[options.output] = partial(write, radiance=field.grid.picture[None])
    return Product(field, figures, writers)
