"""`nolens simulate`: from pictures of a scene to what a simulated camera measures of them."""

from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any

import torch
from pydantic import Field
from torch import Tensor

from nolens.camera import Frame, LoadedCamera, Sensor
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import VirtualExperiment, brightest, render_motion
from nolens.files import is_sequence, read_picture, write_frame, write_tiff32
from nolens.files.frames import check_holds_sensor
from nolens.files.ome import write_ome_tiff
from nolens.files.pictures import Picture, read_moving_picture
from nolens.jobs.bands import band_names, parse_bands, read_cube
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    RESULT,
    Device,
    Distances,
    Exposure,
    FilePath,
    Files,
    FullAngle,
    Interval,
    Name,
    RecordedOptions,
    Seed,
)
from nolens.jobs.options import Option
from nolens.jobs.run import Product, Run, Writer, job
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.quantities import Angle, Luminance, Percentage
from nolens.ranges import Between
from nolens.twin import (
    Plane,
    PlaneView,
    check_field_points,
    check_simulation_memory,
    distance_um,
    in_channels,
    preview_model,
    render_planes,
)

OPTICS, EXPOSURE = "Camera and light", "Exposure"
_TIFF = (".tif", ".tiff")
RAW_SUFFIXES = (".dng", *_TIFF)
FILL = Percentage("90", "%")
Fill = Annotated[Percentage, Between("0.001 %", "10000 %")]
Fresnel = Annotated[
    bool, Option("Light is lost to reflection at the surfaces between layers.", OPTICS)
]
SceneLuminance = Annotated[
    Luminance,
    Between("0.000001 cd/m2", "1000000000000 cd/m2"),
    Option("Of the scene's white.", EXPOSURE, default="200cd/m2, a usual screen"),
]
_REMEDY = (
    "a camera with fewer or larger pixels, a coarser grid of its relief or a smaller --angle needs "
    "less"
)


class SimulationOptions(RecordedOptions):
    """What the simulation of any light has in common."""

    output: FilePath
    camera: Annotated[
        Name, Option(f"Camera to simulate: {CAMERAS}.", role="camera", label="Camera")
    ] = "paper"
    light: Annotated[
        Name,
        Option(f"{LIGHTS}; or a .csv with wavelength_nm,power: an emission spectrum.", OPTICS),
    ] = "white-led"
    wavelengths: Annotated[
        int, Between(1, 100), Option("Wavelengths that stand for a channel.", OPTICS)
    ] = 3
    fresnel: Fresnel = True
    device: Device = "auto"
    fill: Fill | None = None
    seed: Seed = 0


class SimulateOptions(SimulationOptions):
    """Simulate what a lensless camera measures of a scene.

    nolens simulate scene.png --distance 300mm --angle 60deg -o raw.dng --truth truth.tif

    Lengths, angles and the like are given with their unit: 300mm, 60deg, 40ms, 90%.
    """

    usage = "simulate SCENE -o raw.dng"

    scenes: Annotated[
        Files,
        Field(min_length=1),
        Option(
            "Pictures of the scene: .png, .jpg or .tif of 8 or 16 bits (sRGB; alpha is opacity), "
            "or float .tif and .npy (linear, 1 is white). Of several ones, nearer ones hide "
            "farther ones. Or one moving scene: a folder of such pictures, a pattern "
            "('scene/*.png'), a video or another file of many frames; the sensor's lines are "
            "exposed one after another, as its line_time_us and rolling say.",
            needed="the scene (nolens simulate SCENE -o raw.dng)",
            role="input",
            what="scene",
            positional=True,
            label="Scene",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Raw file to write: .dng, or .tif (16-bit counts). The record of the run goes beside "
            "it, as .json.",
            needed="the file to write (-o raw.dng, -o x.tif)",
            role="output",
            suffixes=RAW_SUFFIXES,
            flag="-o",
        ),
    ]
    truth: Annotated[
        FilePath | None,
        Option(
            "Writes what a reconstruction is to show: the scene's radiance on its pixels, as "
            "linear float .tif; of a moving scene all frames, as OME-TIFF.",
            role="output",
            suffixes=_TIFF,
        ),
    ] = None
    response: Annotated[
        FilePath | None,
        Option(
            "Writes how much light of each scene pixel reaches the sensor, 1 for the most, as "
            "float .tif. A reconstruction with one PSF shows truth × response.",
            RESULT,
            role="output",
            suffixes=_TIFF,
        ),
    ] = None
    bands: Annotated[
        Name | None,
        Option(
            "The scene has a picture for each of these: wavelengths (450nm,475nm,...), or angles "
            "of its polarised light (0deg,45deg,...); or a .txt that lists them. It is then an "
            ".npy (bands, rows, columns), OME-TIFF or .mat, linear.",
            default="the scene is a picture",
        ),
    ] = None
    distance: Annotated[
        Distances,
        Option(
            "Distance from the camera to the picture, such as 300mm, or infinity; once, or once "
            "for each picture.",
            default="the camera's reference_distance",
        ),
    ] = ()
    angle: Annotated[
        tuple[FullAngle, ...],
        Field(max_length=1000),
        Option(
            "Field angle of the picture's longer side, from edge to edge, such as 60deg; once, or "
            "once for each picture.",
        ),
    ] = (Angle("60", "deg"),)
    field_points: Annotated[
        int,
        Between(1, 101),
        Option(
            "PSFs along each side of the scene, an odd number; between them they are blended. 1 "
            "takes one PSF for all of it, as a reconstruction does.",
            OPTICS,
        ),
    ] = 5
    fill: Annotated[
        Fill | None,
        Option(
            "Exposes so that the brightest pixel is filled to this fraction of what saturates it.",
            EXPOSURE,
            default="90%",
        ),
    ] = None
    exposure: Annotated[
        Exposure | None,
        Option("Exposure time, such as 40ms.", default="fills the brightest pixel to 90 %"),
    ] = None
    luminance: SceneLuminance = Luminance("200", "cd/m2")
    frame_duration: Annotated[
        Interval | None,
        Option(
            "Of each frame of a moving scene, such as 1ms; the last one stays to the end.",
            EXPOSURE,
            default="the frames share the time from the first line's exposure to the last one's",
        ),
    ] = None
    seed: Annotated[Seed, Option("Of the sensor's noise.", EXPOSURE)] = 0

    def check_together(self) -> None:
        """Refuse two ways of exposing, and values that cannot be shared out to the scenes."""
        if self.fill is not None and self.exposure is not None:
            raise OptionError(
                f"--fill {self.fill} and --exposure {self.exposure} are both given, and each "
                "says how long to expose: leave one out"
            )
        if self.is_moving and self.exposure is None:
            raise OptionError(
                f"{self.scenes[0]} is a moving scene, and how long a line is exposed decides what "
                "it sees of the motion: say it (--exposure 2ms)"
            )
        if self.frame_duration is not None and not self.is_moving:
            raise OptionError(
                f"--frame-duration {self.frame_duration} is for a moving scene: give one folder, "
                "pattern or file of many frames, or leave it out"
            )
        count = len(self.scenes)
        for name, values in (("distance", self.distance), ("angle", self.angle)):
            if len(values) not in (0, 1, count):
                raise OptionError(
                    f"--{name} is given {len(values)} times for {count} scenes: give it once, for "
                    "all of them, or once for each in their order"
                )

    @property
    def is_moving(self) -> bool:
        """Whether the scene is a folder, pattern or file of many frames."""
        return self.bands is None and len(self.scenes) == 1 and is_sequence(self.scenes[0])

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role; those of a moving scene when it is opened."""
        return {} if self.is_moving else super().inputs


def read_simulated_camera(
    run: Run[Any], field_points: int = 1
) -> tuple[LoadedCamera, VirtualExperiment]:
    """The camera of a run with `SimulationOptions`, and its preview model in the run's light.

    Raises
    ------
    NolensError
        If the camera or the light cannot be used, or the output not hold the sensor's counts.
    """
    options: SimulationOptions = run.options
    loaded = run.camera(options.camera)
    check_holds_sensor(options.output, loaded.camera.sensor)
    preview = preview_model(loaded, fresnel=options.fresnel)
    return loaded, VirtualExperiment(
        preview, run.light(options.light), options.wavelengths, field_points
    )


def camera_parameters(loaded: LoadedCamera) -> dict[str, Any]:
    """What the record of a simulation has of its camera."""
    return {"camera_description": loaded.camera.model_dump(mode="json")}


def raw_writer(frame: Frame, exposure_s: float) -> Writer:
    """What writes the frame of a simulated sensor, as DNG or 16-bit TIFF by the suffix."""
    return partial(
        write_frame,
        frame=replace(frame, exposure_s=exposure_s),
        model="nolens simulated camera",
    )


def saturated_fraction(frame: Frame, sensor: Sensor) -> float:
    """Fraction of the pixels that are saturated."""
    return float((frame.counts >= sensor.saturated_counts).double().mean())


@job
def simulate(run: Run[SimulateOptions]) -> Product[Tensor]:
    """Radiance of the scene on the pixels of the reconstruction, (channels, height, width).

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options = run.options
    loaded, preview = read_simulated_camera(run, options.field_points)
    check_field_points(options.field_points)
    bands = () if options.bands is None else parse_bands(run, options.bands)
    if bands:
        pictures = [Picture(read_cube(path, bands)) for path in options.scenes]
    elif options.is_moving:
        pictures, sources = read_moving_picture(options.scenes[0])
        run.reads({f"frame {path.name}": path for path in sources})
    else:
        pictures = [read_picture(path) for path in options.scenes]
    planes = _planes(options, loaded, pictures)
    moving = options.is_moving
    working = preview.motion_bytes(planes[0]) if moving else preview.scene_bytes(planes)
    # The views take memory too, and refuse a scene that is too near: before the relief.
    check_simulation_memory(loaded, working, run.device, _REMEDY)
    common: dict[str, Any] = {
        "luminance_cd_m2": options.luminance.cd_m2,
        "seed": options.seed,
    }
    progress = partial(run.reporter.advance, "scene")
    exposure_s = None if options.exposure is None else options.exposure.s
    if moving and exposure_s is not None:
        field, scenes = render_motion(preview.twin, planes)
        twin = run.twin(loaded, working, _REMEDY, fresnel=options.fresnel)
        experiment = replace(preview, twin=twin)
        shot = experiment.measure_motion(
            experiment.field_model(field, planes[0].distance_um, progress),
            scenes,
            exposure_s=exposure_s,
            frame_s=None if options.frame_duration is None else options.frame_duration.s,
            **common,
        )
    else:
        field, views = render_planes(preview.twin, planes, len(bands) or None)
        if exposure_s is None:
            _check_light(views)
        twin = run.twin(loaded, working, _REMEDY, fresnel=options.fresnel)
        shot = replace(preview, twin=twin).measure_views(
            field,
            views,
            fill=(options.fill or FILL).value,
            exposure_s=exposure_s,
            bands=bands,
            progress=progress,
            **common,
        )
    run.warn(*shot.warnings)
    largest_angle = max(PointSource(plane.tangents).angle_deg for plane in planes)
    support, pixels = field.support, preview.twin.shape
    if bands:  # They are reconstructed on all pixels.
        side = preview.twin.superpixel
        support, pixels = support.finer(side), (pixels[0] * side, pixels[1] * side)
    figures = {
        "camera": loaded.camera.name,
        "support": _support_text(support, pixels),
        "pixels": list(pixels),
        "psf_pixels": "{}x{}".format(*preview.twin.psf_shape(field.support)),
        "exposure_s": shot.exposure_s,
        "brightest_electrons": shot.brightest_electrons,
        "saturated_fraction": saturated_fraction(shot.frame, loaded.camera.sensor),
        "field_points": shot.field_points,
        "field_error": shot.field_error,
        "largest_angle_deg": round(largest_angle, 3),
    }
    writers = {options.output: raw_writer(shot.frame, shot.exposure_s)}
    truth, channels, more = shot.truth, loaded.camera.sensor.channels, {}
    if bands:
        truth, channels, more = truth[None], *band_names(bands)
    for path, picture in ((options.truth, truth), (options.response, shot.response[None])):
        if path is not None and picture.ndim == 4:
            writers[path] = partial(
                write_ome_tiff,
                stack=picture,
                axis="T",
                channels=channels,
                pixels={},
                about_channels=more,
            )
        elif path is not None:
            writers[path] = partial(write_tiff32, radiance=picture)
    return Product(shot.truth, figures, writers, camera_parameters(loaded))


def _planes(
    options: SimulateOptions, loaded: LoadedCamera, pictures: list[Picture]
) -> tuple[Plane, ...]:
    """The pictures, in the sensor's channels, where they stand."""
    channels = len(loaded.camera.sensor.channels)
    distances = [distance_um(each, loaded) for each in options.distance or (None,)]
    # Of distances and angles there is one, or one for each picture.
    places = zip(pictures, cycle(options.angle), cycle(distances), strict=False)
    return tuple(
        Plane(
            picture.radiance if options.bands else in_channels(picture.radiance, channels),
            angle.deg,
            distance,
            picture.opacity,
        )
        for picture, angle, distance in places
    )


def _check_light(views: tuple[PlaneView, ...]) -> None:
    """Refuse a scene without light: an exposure that depends on the brightest pixel has none."""
    try:
        brightest(torch.stack([view.radiance for view in views]).sum(dim=0))
    except DataError as error:
        raise DataError(f"{error}, or say how long to expose (--exposure 40ms)") from None


def _support_text(support: PixelRectangle, sensor: tuple[int, int]) -> str:
    """As `nolens reconstruct --support` takes it."""
    text = f"{support.height}x{support.width}"
    if support == PixelRectangle.centred(support.height, support.width, sensor):
        return text
    return f"{text}{support.top:+d}{support.left:+d}"
