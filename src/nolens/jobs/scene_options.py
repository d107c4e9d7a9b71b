"""Options of `nolens simulate` and `nolens psf`."""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field

from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import (
    CAMERAS,
    LIGHTS,
    Bin,
    Device,
    Distances,
    Exposure,
    FieldAngles,
    FilePath,
    Files,
    FullAngle,
    Name,
    Seed,
    Word,
    record_beside,
)
from nolens.jobs.options import JobOptions, Option, Written
from nolens.quantities import Angle, Length, Luminance, Share
from nolens.ranges import Between

_SCENE, _POINT, _RESULT = "Scene", "Point source", "Result"
_OPTICS, _EXPOSURE = "Camera and light", "Exposure"
_CELLS = re.compile(r"([0-9]{1,6})x([0-9]{1,6})")
_Luminance = Annotated[Luminance, Between("0.000001 cd/m2", "1000000000000 cd/m2")]
_Side = Annotated[int, Between(1, 65535)]


def _two_sizes(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    match = _CELLS.fullmatch(given.strip())
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise refusal("give HEIGHTxWIDTH in pixels, such as 400x600")
    return int(match[1]), int(match[2])


_Fill = Annotated[Share, Between("0.001 %", "10000 %")]
_RAW = (".dng", ".tif", ".tiff")


class CameraOptions(JobOptions):
    """What the simulation of any light has in common."""

    pictures: ClassVar[tuple[str, ...]] = ()
    """Suffixes of pictures for looking at that may be written in place of counts."""

    output: FilePath
    camera: Annotated[Name, Option(f"{CAMERAS}.", _OPTICS, role="camera", label="Camera")] = "paper"
    light: Annotated[Word, Option(f"{LIGHTS}.", _OPTICS)] = "white-led"
    wavelengths: Annotated[
        int, Between(1, 100), Option("Wavelengths that stand for a channel.", _OPTICS)
    ] = 3
    fresnel: Annotated[
        bool, Option("Light is lost to reflection at the surfaces between layers.", _OPTICS)
    ] = True
    device: Device = "auto"
    fill: _Fill | None = None
    seed: Seed = 0

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return record_beside(self.output)


class SimulateOptions(CameraOptions):
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
            _RESULT,
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
            _RESULT,
            role="output",
        ),
    ] = None
    response: Annotated[
        FilePath | None,
        Option(
            "Writes how much light of each scene pixel reaches the sensor, 1 for the most, as "
            "float .tif. A reconstruction with one PSF shows truth × response.",
            _RESULT,
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
            _OPTICS,
        ),
    ] = 5
    fill: Annotated[
        _Fill | None,
        Option(
            "Exposes so that the brightest pixel is filled to this fraction of what saturates it.",
            _EXPOSURE,
            default="90%",
        ),
    ] = None
    exposure: Annotated[
        Exposure | None, Option("Exposure time, such as 40ms, instead of --fill.", _EXPOSURE)
    ] = None
    luminance: Annotated[
        _Luminance,
        Option("Of the scene's white.", _EXPOSURE, default="200cd/m2, a usual screen"),
    ] = Luminance("200", "cd/m2")
    seed: Annotated[Seed, Option("Of the sensor's noise.", _EXPOSURE)] = 0

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
        return (Written("output", self.output, suffixes=_RAW), *more, record)


class PsfOptions(CameraOptions):
    """Simulate what a lensless camera shows of a point source.

    nolens psf --camera paper --angle 20deg,0deg --distance 80mm -o psf.tif
    """

    usage = "psf -o psf.tif"
    pictures = (".png",)

    output: Annotated[
        FilePath,
        Option(
            ".tif (linear floats without noise), .dng (every pixel, exposed, with noise) or .png "
            "(for looking at). The record of the run goes beside it, as .json. A .dng states the "
            "exposure time that a source needs which gives 1 lx at the camera, straight ahead.",
            _RESULT,
            needed="the file to write (-o raw.dng, -o x.tif)",
            role="output",
            flag="-o",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option("Angles to the right and up, as the photographer sees them.", _POINT, former="at"),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    distance: Annotated[
        Depth | None,
        Option(
            "From the camera, or infinity.",
            _POINT,
            default="the camera's reference_distance",
            former="depth",
        ),
    ] = None
    size: Annotated[
        Annotated[Length, Between("0 µm", "10 m")] | None,
        Option("Diameter of the light.", _POINT, default="50um; 0um at infinity"),
    ] = None
    cells: Annotated[
        tuple[_Side, _Side] | None,
        BeforeValidator(_two_sizes),
        Option(
            "HEIGHTxWIDTH of the result; more than the sensor has shows the light beside it too, "
            "for reconstruct --psf-extent wide.",
            _RESULT,
            default="the sensor",
        ),
    ] = None
    bin: Annotated[
        Bin | None,
        Option(
            "Sensor pixels along one of the result; 1 for all pixels.",
            _RESULT,
            default="the pixels of a reconstruction; for .dng 1",
        ),
    ] = None
    frame: Annotated[
        Literal["chief-ray", "sensor"] | None,
        Option(
            "The middle of the result follows the ray through the middle of the camera, or stays "
            "on the sensor's.",
            _RESULT,
            default="chief-ray; for .dng sensor",
        ),
    ] = None
    fill: Annotated[
        _Fill | None,
        Option(
            "For .dng, fraction of what saturates it to which the brightest pixel is filled.",
            _EXPOSURE,
            default="90%",
        ),
    ] = None
    seed: Annotated[Seed, Option("For .dng, of the sensor's noise.", _EXPOSURE)] = 0

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF and record."""
        output = Written("output", self.output, suffixes=(*_RAW, *self.pictures))
        return (output, Written("record of the run", self.record))
