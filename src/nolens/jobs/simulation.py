"""`nolens simulate`: from pictures of a scene to what a simulated camera measures of them."""

import math
from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import Annotated, Any, ClassVar

import torch
from pydantic import Field
from torch import Tensor

from nolens.camera import LoadedCamera, Sensor
from nolens.errors import DataError, OptionError
from nolens.experiments.virtual_experiment import raw_frame
from nolens.files import camera_files, read_camera, read_picture, write_frame, write_tiff32
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
    Name,
    Seed,
    Word,
    record_beside,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Run, Writer, check_memory, job
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.quantities import Angle, Luminance, Share
from nolens.ranges import Between
from nolens.twin import (
    Light,
    Plane,
    Twin,
    check_field_points,
    colours_of,
    distance_um,
    expose,
    in_channels,
    irradiate,
    irradiate_bytes,
    mosaic,
    photocurrents,
    preview_model,
    relief_points,
    render_planes,
    simulation_bytes,
)

OPTICS, EXPOSURE = "Camera and light", "Exposure"
RAW_SUFFIXES = (".dng", ".tif", ".tiff")
FILL = Share("90", "%")
Fill = Annotated[Share, Between("0.001 %", "10000 %")]
_SCENE = "Scene"
_Luminance = Annotated[Luminance, Between("0.000001 cd/m2", "1000000000000 cd/m2")]
_REMEDY = (
    "a camera with fewer or larger pixels, a coarser grid of its relief or a smaller --angle needs "
    "less"
)
_VISIBLE = 0.3
"""Fraction of the noise from which on the error of the field points is worth a warning."""


class SimulationOptions(JobOptions):
    """What the simulation of any light has in common."""

    pictures: ClassVar[tuple[str, ...]] = ()
    """Suffixes of pictures for looking at that may be written in place of counts."""

    output: FilePath
    camera: Annotated[Name, Option(f"{CAMERAS}.", OPTICS, role="camera", label="Camera")] = "paper"
    light: Annotated[Word, Option(f"{LIGHTS}.", OPTICS)] = "white-led"
    wavelengths: Annotated[
        int, Between(1, 100), Option("Wavelengths that stand for a channel.", OPTICS)
    ] = 3
    fresnel: Annotated[
        bool, Option("Light is lost to reflection at the surfaces between layers.", OPTICS)
    ] = True
    device: Device = "auto"
    fill: Fill | None = None
    seed: Seed = 0

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return record_beside(self.output)


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
            "Pictures: .png, .jpg or .tif of 8 or 16 bits (sRGB; alpha is opacity), or float .tif "
            "and .npy (linear, 1 is white). Of several ones, nearer ones hide farther ones.",
            needed="the scene (nolens simulate SCENE -o raw.dng)",
            role="input",
            positional=True,
            label="Scene",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Raw file to write: .dng, or .tif (16-bit counts). The record of the run goes beside "
            "it, as .json.",
            RESULT,
            needed="the file to write (-o raw.dng, -o x.tif)",
            role="output",
            flag="-o",
        ),
    ]
    truth: Annotated[
        FilePath | None,
        Option(
            "Writes what a reconstruction is to show: the scene's radiance on its pixels, as "
            "linear float .tif.",
            RESULT,
            role="output",
        ),
    ] = None
    response: Annotated[
        FilePath | None,
        Option(
            "Writes how much light of each scene pixel reaches the sensor, 1 for the most, as "
            "float .tif. A reconstruction with one PSF shows truth × response.",
            RESULT,
            role="output",
        ),
    ] = None
    distance: Annotated[
        Distances,
        Option(
            "From the camera to the picture, or infinity; once, or once for each picture.",
            _SCENE,
            default="the camera's reference_distance",
        ),
    ] = ()
    angle: Annotated[
        tuple[FullAngle, ...],
        Field(max_length=1000),
        Option(
            "Field angle of the picture's longer side, from edge to edge; once, or once for each.",
            _SCENE,
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
        Exposure | None, Option("Exposure time, such as 40ms, instead of --fill.", EXPOSURE)
    ] = None
    luminance: Annotated[
        _Luminance,
        Option("Of the scene's white.", EXPOSURE, default="200cd/m2, a usual screen"),
    ] = Luminance("200", "cd/m2")
    seed: Annotated[Seed, Option("Of the sensor's noise.", EXPOSURE)] = 0

    def check_together(self) -> None:
        """Refuse two ways of exposing, and values that cannot be shared out to the scenes."""
        if self.fill is not None and self.exposure is not None:
            raise OptionError(
                f"--fill {self.fill} and --exposure {self.exposure} are both given, and each "
                "says how long to expose: leave one out"
            )
        count = len(self.scenes)
        for name, values in (("distance", self.distance), ("angle", self.angle)):
            if len(values) not in (0, 1, count):
                raise OptionError(
                    f"--{name} is given {len(values)} times for {count} scenes: give it once, for "
                    "all of them, or once for each in their order"
                )

    @property
    def inputs(self) -> dict[str, Path]:
        """Pictures, by role."""
        if len(self.scenes) == 1:
            return {"scene": self.scenes[0]}
        return {f"scene {number}": path for number, path in enumerate(self.scenes, start=1)}

    @property
    def written(self) -> tuple[Written, ...]:
        """Raw file, truth, response and record."""
        more = [
            Written(name, path, f"--{name}", (".tif", ".tiff"))
            for name, path in (("truth", self.truth), ("response", self.response))
            if path is not None
        ]
        record = Written("record of the run", self.record)
        return (Written("output", self.output, suffixes=RAW_SUFFIXES), *more, record)


def read_simulated_camera(run: Run[Any]) -> tuple[LoadedCamera, Light, Twin]:
    """The camera and the light of a run with `SimulationOptions`, and the camera's preview model.

    Raises
    ------
    NolensError
        If the camera or the light cannot be used, or the output not hold the sensor's counts.
    """
    options: SimulationOptions = run.options
    opened = read_camera(options.camera)
    _check_raw(options.output, opened.camera.sensor)
    run.reads(camera_files(options.camera, opened.camera))
    return opened, Light(options.light), preview_model(opened, fresnel=options.fresnel)


def camera_parameters(opened: LoadedCamera) -> dict[str, Any]:
    """What the record of a simulation has of its camera."""
    return {"camera_description": opened.camera.model_dump(mode="json")}


def _check_raw(path: Path, sensor: Sensor) -> None:
    """Refuse a DNG of a sensor without a colour mosaic or a whole black level."""
    if path.suffix.lower() != ".dng":
        return
    if sensor.mosaic == "none":
        raise OptionError(
            f"{path.name} would be a DNG, which holds a colour mosaic, and the sensor "
            f"{sensor.name!r} has none: write {path.with_suffix('.tif').name}"
        )
    if not sensor.black_counts.is_integer():
        raise OptionError(
            f"{path.name} would be a DNG with a whole black level, and the sensor {sensor.name!r} "
            f"has {sensor.black_counts:g}: write {path.with_suffix('.tif').name}, or round it"
        )


def raw_writer(counts: Tensor, opened: LoadedCamera, exposure_s: float) -> Writer:
    """What writes the counts of a simulated sensor, as DNG or 16-bit TIFF by the suffix."""
    return partial(
        write_frame,
        frame=raw_frame(counts, opened.camera, exposure_s),
        model="nolens simulated camera",
    )


def saturated_fraction(counts: Tensor, sensor: Sensor) -> float:
    """Fraction of the pixels that are saturated."""
    return float((counts >= sensor.saturated_counts).double().mean())


@job
def simulate(run: Run[SimulateOptions]) -> Product[Tensor]:
    """Radiance of the scene on the pixels of the reconstruction, (channels, height, width).

    Raises
    ------
    NolensError
        If an input, an option or an output cannot be used; then nothing is written.
    """
    options, reporter, device = run.options, run.reporter, run.device
    opened, light, bare = read_simulated_camera(run)
    sensor = opened.camera.sensor
    check_field_points(options.field_points)
    planes = _planes(options, opened)
    colours = colours_of(bare, light, options.wavelengths)
    working = irradiate_bytes(bare, planes, options.field_points, colours)
    needed = BYTES_OF_PROGRAM + simulation_bytes(relief_points(opened), working)
    check_memory(needed, device, _REMEDY)
    field, seen = render_planes(bare, planes)
    truth = torch.stack([plane.radiance for plane in seen]).sum(dim=0)
    if options.exposure is None:
        _brightest(truth)
    run.begin(needed)

    reporter.advance("mask", 0.0)
    twin = Twin.of(opened, device=device, fresnel=options.fresnel)
    irradiated = irradiate(
        twin,
        replace(field, twin=twin),
        seen,
        field_points=options.field_points,
        light=light,
        wavelengths=options.wavelengths,
        progress=partial(reporter.advance, "scene"),
    )
    currents = photocurrents(twin, light, options.luminance.cd_m2)[:, None, None]
    rate = irradiated.light * mosaic(currents.expand(-1, *irradiated.light.shape), sensor.mosaic)
    if options.exposure is not None:
        exposure_s = options.exposure.s
    else:
        exposure_s = (options.fill or FILL).value * sensor.clip_electrons / _brightest(rate)
    electrons = rate * exposure_s
    counts = expose(electrons, sensor, seed=options.seed)
    error = irradiated.relative_error(rate.double() * exposure_s, sensor)
    run.warn(*_warnings(error, options.field_points))

    response = field.solid_angle() * field.vignetting()
    largest_angle = max(PointSource(plane.tangents).angle_deg for plane in planes)
    figures = {
        "camera": opened.camera.name,
        "support": _region(field.region, twin.shape),
        "pixels": list(twin.shape),
        "psf_pixels": _psf_pixels(field.region, twin),
        "exposure_s": exposure_s,
        "brightest_electrons": float(electrons.max()),
        "saturated_fraction": saturated_fraction(counts, sensor),
        "field_points": options.field_points,
        "field_error": error,
        "largest_angle_deg": round(largest_angle, 3),
    }
    writers = {options.output: raw_writer(counts, opened, exposure_s)}
    if options.truth is not None:
        writers[options.truth] = partial(write_tiff32, radiance=truth)
    if options.response is not None:
        relative = (response / response.max()).float()[None]
        writers[options.response] = partial(write_tiff32, radiance=relative)
    return Product(truth, figures, writers, camera_parameters(opened))


def _psf_pixels(region: Region, twin: Twin) -> str:
    """Pixels of a PSF that a reconstruction needs, as `nolens psf --pixels` takes them.

    Without an aperture light from the side passes mask that the sensor's own PSF does not show.
    """
    rows, columns = twin.shape
    if twin.mask.opening is None:
        rows, columns = rows + region.height, columns + region.width
    return f"{rows}x{columns}"


def _planes(options: SimulateOptions, opened: LoadedCamera) -> tuple[Plane, ...]:
    """The pictures, in the sensor's channels, where they stand."""
    channels = len(opened.camera.sensor.channels)
    distances = [distance_um(each, opened) for each in options.distance or (None,)]
    planes = []
    # Of distances and angles there is one, or one for each picture.
    places = zip(options.scenes, cycle(options.angle), cycle(distances), strict=False)
    for path, angle, distance in places:
        picture = read_picture(path)
        radiance = in_channels(picture.radiance, channels)
        planes.append(Plane(radiance, angle.deg, distance, picture.opacity))
    return tuple(planes)


def _brightest(light: Tensor) -> float:
    """What the exposure goes by."""
    brightest = float(light.max())
    if not brightest > 0:
        raise DataError(
            "no light reaches the sensor: the scene is black, or all of it is hidden. Give a "
            "brighter scene, or say how long to expose (--exposure 40ms)"
        )
    return brightest


def _warnings(error: dict[str, float] | None, field_points: int) -> list[str]:
    if error is None or error["of_noise"] <= _VISIBLE:
        return []
    # Bilinear interpolation errs with the square of the distance of its points.
    steps = (field_points - 1) * math.sqrt(error["of_noise"] / _VISIBLE)
    better = 2 * math.ceil(steps / 2) + 1
    return [
        f"between the {field_points}×{field_points} field points the simulation is off by "
        f"{error['of_noise']:.2g} of the noise: try --field-points {better}"
    ]


def _region(region: Region, sensor: tuple[int, int]) -> str:
    """As `nolens reconstruct --support` takes it."""
    text = f"{region.height}x{region.width}"
    if region == Region.centred(region.height, region.width, sensor):
        return text
    return f"{text}{region.top:+d}{region.left:+d}"
