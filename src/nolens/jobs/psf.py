"""`nolens psf`: what a simulated camera shows of one point source."""

import math
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from torch import Tensor

from nolens.camera import LoadedCamera
from nolens.camera.psf_set import Depth
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment
from nolens.files import PSFS_FILE, write_png, write_tiff32
from nolens.files.psf_folder import PsfFolder
from nolens.jobs.calibration.folder import added, distance_name, field_entries
from nolens.jobs.fields import RESULT, Bin, FieldAngles, FilePath, FullAngle, Seed, parts
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Run, job
from nolens.jobs.simulation import (
    EXPOSURE,
    FILL,
    RAW_SUFFIXES,
    Fill,
    SimulationOptions,
    camera_parameters,
    raw_writer,
    read_simulated_camera,
    saturated_fraction,
)
from nolens.optics import PointSource
from nolens.quantities import Angle, Length
from nolens.ranges import Between
from nolens.twin import (
    LARGEST_ANGLE_DEG,
    FieldMap,
    Frame,
    check_field_points,
    distance_um,
    mosaic,
    photocurrents,
)

_POINT = "Point source"
_SIZE = r"([1-9][0-9]{0,5})x([1-9][0-9]{0,5})"
_Side = Annotated[int, Between(1, 65535)]
_REMEDY = "fewer --pixels, a camera with fewer pixels or a coarser grid of its relief needs less"
_FIELD_REMEDY = "fewer --field-points, a smaller --field or a camera with fewer pixels needs less"
_BYTES_OF_FIELD = 12
"""Of each pixel of the PSFs over the field: as they are computed, and made equally bright."""
_DIAMETER_UM = 50.0
"""Of the paper's point source, a pinhole."""
_LUX = 1.0
"""Illuminance at the camera by a source straight ahead, to which exposure times are stated."""


class PsfOptions(SimulationOptions):
    """Simulate what a lensless camera shows of a point source.

    nolens psf --camera paper -o psf.tif

    nolens psf --camera paper --angle 20deg,0deg --distance 80mm -o psf.tif

    nolens psf --camera paper --field 60deg --field-points 3 -o mycamera
    """

    usage = "psf -o psf.tif"

    output: Annotated[
        FilePath,
        Option(
            "File to write: .tif (linear floats without noise), .dng (every pixel, exposed, with "
            "noise) or .png (for looking at). The record of the run goes beside it, as .json. A "
            ".dng states the exposure time that a source needs which gives 1 lx at the camera, "
            "straight ahead. With --field-points, the folder of the camera.",
            needed="the file to write (-o raw.dng, -o x.tif)",
            role="output",
            suffixes=(*RAW_SUFFIXES, ".png"),
            flag="-o",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option(
            "Field angles of the point source, to the right and up as the photographer sees them, "
            "such as 20deg,-10deg.",
            default="0deg,0deg",
            former="at",
        ),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    distance: Annotated[
        Depth | None,
        Option(
            "Distance of the point source from the camera, such as 80mm, or infinity.",
            default="the camera's reference_distance",
            former="depth",
        ),
    ] = None
    field_points: Annotated[
        int,
        Between(1, 101),
        Option(
            "PSFs along each side of a scene, an odd number, into a camera's folder (-o FOLDER): "
            "reconstruct --psf FOLDER uses all of them. Needs --field.",
        ),
    ] = 1
    field: Annotated[
        FullAngle | None,
        Option("For --field-points: the angle that the scene fills from side to side."),
    ] = None
    size: Annotated[
        Annotated[Length, Between("0 µm", "10 m")] | None,
        Option("Diameter of the light.", _POINT, default="50um; 0um at infinity"),
    ] = None
    pixels: Annotated[
        tuple[_Side, _Side] | None,
        parts(_SIZE, "give HEIGHTxWIDTH in pixels, such as 400x600"),
        Option(
            "HEIGHTxWIDTH of the result; more than the sensor has shows the light beside it too, "
            "for reconstruct --psf-extent wide.",
            default="the sensor",
            former="cells",
        ),
    ] = None
    bin: Annotated[
        Bin | None,
        Option(
            "Sensor pixels along one of the result; 1 for all pixels.",
            RESULT,
            default="the pixels of a reconstruction; for .dng 1",
        ),
    ] = None
    frame: Annotated[
        Literal["chief-ray", "sensor"] | None,
        Option(
            "The middle of the result follows the ray through the middle of the camera, or stays "
            "on the sensor's.",
            RESULT,
            default="chief-ray; for .dng sensor",
        ),
    ] = None
    fill: Annotated[
        Fill | None,
        Option(
            "For .dng, fraction of what saturates it to which the brightest pixel is filled.",
            EXPOSURE,
            default="90%",
        ),
    ] = None
    seed: Annotated[Seed, Option("For .dng, of the sensor's noise.", EXPOSURE)] = 0

    def check_together(self) -> None:
        """Refuse a scene without field points, or the other way, and what is of one PSF alone."""
        if (self.field is not None) != (self.field_points > 1):
            raise OptionError(
                "--field and --field-points belong together: PSFs at so many points along each "
                "side of a scene. Give both, such as --field 60deg --field-points 3, or none"
            )
        if self.field is None:
            return
        for name in ("angle", "pixels", "bin", "frame", "fill", "seed"):
            if name in self.model_fields_set:
                raise OptionError(
                    f"--{name} is of one point source, and --field-points {self.field_points} "
                    "chooses those of a whole scene: leave one out"
                )
        if self.output.suffix.lower() in (*RAW_SUFFIXES, ".png"):
            raise OptionError(
                f"{self.output} would be a file, and --field-points {self.field_points} fills a "
                "camera's folder: give the name of a folder, such as -o mycamera"
            )

    @property
    def files(self) -> tuple[Written, ...]:
        """The PSF's file, or the list of a folder's; the names there follow from the angles."""
        if self.field is None:
            return super().files
        return (Written("list of PSFs", self.output / PSFS_FILE),)

    @property
    def record(self) -> Path | None:
        """File of the run's record; in a folder, named after the distance once that is known."""
        if self.field is None:
            return super().record
        distance = self.distance
        return None if distance is None else self.output / f"psf-{distance_name(distance)}.json"

    @property
    def output_folder(self) -> Path | None:
        """The camera's, with field points."""
        return None if self.field is None else self.output


class _Shape(NamedTuple):
    """What is computed: (rows, columns) of so many sensor pixels each, in one of the frames."""

    size: tuple[int, int]
    pixels: int
    frame: Frame


@job
def simulate_psf(run: Run[PsfOptions]) -> Product[Tensor]:
    """Irradiance without noise, (channels, rows, columns), by a camera of a point source.

    Each channel is as bright as the sensor sees it beside the brightest one.

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter = run.options, run.reporter
    loaded, preview = read_simulated_camera(run)
    if options.field is not None:
        return _simulate_field(run, options.field, loaded, preview)
    captured = options.output.suffix.lower() == ".dng"
    shape = _shape(options, loaded, captured)
    source = _source(options, loaded)
    working = preview.psf_bytes(source, shape.size, shape.pixels)
    twin = run.twin(loaded, working, _REMEDY, fresnel=options.fresnel)
    experiment = replace(preview, twin=twin)
    # Its channels are as a captured one has them: a scene in this light keeps its own colours.
    psf = experiment.psf(
        source,
        shape.size,
        partial(reporter.advance, "point source"),
        pixels=shape.pixels,
        frame=shape.frame,
    )
    if not float(psf.max()) > 0:
        raise DataError(
            f"no light from {source.angle_deg:.4g} deg off the axis reaches these pixels: they do "
            "not accept it, or it falls beside them. Choose a smaller angle or more --pixels"
        )
    shift = twin.shift_um(source)
    figures = {
        "camera": loaded.camera.name,
        "angle_deg": round(source.angle_deg, 3),
        "shift_um": [round(shift[1], 3), round(0.0 - shift[0], 3)],
        "pixels": list(shape.size),
        "sensor_pixels_per_pixel": shape.pixels,
        "frame": shape.frame,
        "mean": float(psf.mean()),
        "peak_over_mean": float(psf.max() / psf.mean()),
    }
    if captured:
        image = mosaic(psf, experiment.sensor.mosaic)
        fill = (options.fill or FILL).value
        currents = photocurrents(twin, experiment.light, 1.0)
        exposure_s = experiment.exposure_of(image, fill) / (_LUX * float(currents.max()))
        frame = experiment.exposed(image, fill, options.seed)
        figures["exposure_s"] = exposure_s
        figures["saturated_fraction"] = saturated_fraction(frame, experiment.sensor)
        write = raw_writer(frame, exposure_s)
    elif options.output.suffix.lower() == ".png":
        reporter.note(
            f"{options.output} is for looking at: reconstruct with the .tif or .dng of this PSF"
        )
        write = partial(write_png, radiance=psf)
    else:
        sensor = experiment.sensor.rows // shape.pixels, experiment.sensor.columns // shape.pixels
        write = partial(write_tiff32, radiance=psf, sensor=sensor)
    return Product(psf, figures, {options.output: write}, camera_parameters(loaded))


def _simulate_field(
    run: Run[PsfOptions], angle: Angle, loaded: LoadedCamera, preview: VirtualExperiment
) -> Product[Tensor]:
    """PSFs at the field points of a scene, into the camera's folder."""
    check_field_points(run.options.field_points)
    distance = run.options.distance or loaded.camera.reference_distance
    options = run.options = run.options.model_copy(update={"distance": distance})
    folder = PsfFolder(options.output)
    copies = folder.take(options.camera)
    source, tangent = _source(options, loaded), math.tan(angle.rad / 2)
    support = FieldMap.covering(preview.twin, (tangent, tangent)).support
    size = preview.twin.psf_shape(support)
    corner = replace(source, tangent=(tangent, tangent)).within(LARGEST_ANGLE_DEG)
    channels = loaded.camera.sensor.channels
    folder.check_channels(tuple(channels))
    points = options.field_points**2 * len(channels) * math.prod(size)
    working = preview.psf_bytes(corner, size) + _BYTES_OF_FIELD * points
    twin = run.twin(loaded, working, _FIELD_REMEDY, fresnel=options.fresnel)
    psfs = replace(preview, twin=twin).field_psf(
        support,
        options.field_points,
        source.distance_um,
        source.diameter_um,
        partial(run.reporter.advance, "point sources"),
    )
    sensor = loaded.camera.sensor
    made = field_entries(
        psfs,
        loaded.camera,
        folder.pitch(sensor.pitch, sensor.superpixel),
        distance,
        "captured" if size == twin.shape else "extended",
    )
    figures = {
        "camera": loaded.camera.name,
        "psfs": [entry.model_dump(mode="json") for entry in made],
        "pixels": list(size),
        "support": f"{support.height}x{support.width}",
        "largest_angle_deg": round(corner.angle_deg, 3),
    }
    return added(psfs.on_axis, figures, options.output, made, copies, twin.shape)


def _source(options: PsfOptions, loaded: LoadedCamera) -> PointSource:
    depth = distance_um(options.distance, loaded)
    diameter = 0.0 if math.isinf(depth) else _DIAMETER_UM
    if options.size is not None:
        diameter = options.size.um
    if diameter > 0 and math.isinf(depth):
        raise OptionError(
            f"--size {options.size} at infinity: a light there has no diameter. Leave --size out, "
            "or give a --distance"
        )
    right, up = (math.tan(angle.rad) for angle in options.angle)
    return PointSource((-up, right), depth, diameter)


def _shape(options: PsfOptions, loaded: LoadedCamera, captured: bool) -> _Shape:
    sensor = loaded.camera.sensor
    if captured:
        if options.bin not in (None, 1):
            raise OptionError(
                f"--bin {options.bin}: {options.output.name} is a DNG, which holds every pixel; "
                f"leave --bin out, or write {options.output.with_suffix('.tif').name}"
            )
        size = options.pixels or (sensor.rows, sensor.columns)
        if size[0] % 2 or size[1] % 2:
            raise OptionError(
                f"--pixels {size[0]}x{size[1]} do not make whole superpixels of the mosaic "
                f"{sensor.mosaic}: for a DNG, give even numbers of pixels"
            )
        return _Shape(size, 1, options.frame or "sensor")
    for name, value in (("--fill", options.fill), ("--seed", options.seed or None)):
        if value is not None:
            raise OptionError(
                f"{name} {value}: {options.output.name} holds the PSF without exposure and "
                f"noise; leave {name} out, or write "
                f"{options.output.with_suffix('.dng').name}"
            )
    by = options.bin or sensor.superpixel
    size = options.pixels or (sensor.rows // by, sensor.columns // by)
    if 0 in size:
        raise OptionError(
            f"--bin {by} is more than the sensor's {sensor.rows}×{sensor.columns} pixels: "
            "give a smaller one"
        )
    return _Shape(size, by, options.frame or "chief-ray")
