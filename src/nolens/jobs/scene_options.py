"""What `nolens simulate` and `nolens psf` can be told, as frozen models."""

import re
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AliasChoices, BeforeValidator, Field

from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.device import DeviceName
from nolens.jobs.fields import (
    Bin,
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
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Length, Luminance, Share
from nolens.ranges import Between

_CELLS = re.compile(r"([0-9]{1,6})x([0-9]{1,6})")
_Luminance = Annotated[Luminance, Between("0.000001 cd/m2", "1000000000000 cd/m2")]
_Side = Annotated[int, Between(1, 65535)]


def _two_sizes(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    match = _CELLS.fullmatch(given.strip())
    if match is None or 0 in (int(match[1]), int(match[2])):
        raise refusal("give HEIGHTxWIDTH in cells, such as 400x600")
    return int(match[1]), int(match[2])


class CameraOptions(JobOptions):
    """What the simulation of any light is told.

    Attributes
    ----------
    output
        File that is written first.
    camera
        Preset, folder or .toml file.
    light
        Spectrum of the light, one of `nolens.twin.LIGHTS` or a wavelength such as 535nm.
    wavelengths
        How many stand for a channel of the sensor.
    fresnel
        Whether light is lost at the surfaces between media.
    fill
        Share of a full pixel that the brightest one is exposed to; None leaves it to the job.
    seed
        Of the sensor's noise.
    device
        auto, cpu or cuda.
    """

    pictures: ClassVar[tuple[str, ...]] = ()
    """Suffixes of pictures for looking at that may be written in place of counts."""

    output: FilePath
    camera: Name = "paper"
    light: Word = "white-led"
    wavelengths: Annotated[int, Between(1, 100)] = 3
    fresnel: bool = True
    fill: Annotated[Share, Between("0.001 %", "10000 %")] | None = None
    seed: Seed = 0
    device: DeviceName = "auto"

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("output"):
            raise OptionError("no output is given; name the file to write (-o raw.dng, -o x.tif)")
        return cls.checked(given)

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return record_beside(self.output)

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the camera's."""
        return {}


class SimulateOptions(CameraOptions):
    """What `nolens simulate` can be told.

    Attributes
    ----------
    scenes
        Pictures; nearer ones hide farther ones.
    truth, response
        Where to write the scene's radiance on the cells of the reconstruction, and how much of
        it each cell gives.
    distance
        Of all pictures or of each one; none takes the camera's reference_distance.
    angle
        Field angle of a picture's longer side, of all or of each one.
    field_points
        Point spread functions along each side of the scene; odd.
    exposure
        Exposure time, instead of `fill`.
    luminance
        Of the scene's white.
    """

    scenes: Files = Field(min_length=1)
    truth: FilePath | None = None
    response: FilePath | None = None
    distance: Distances = ()
    angle: Annotated[tuple[FullAngle, ...], Field(max_length=1000)] = (Angle("60", "deg"),)
    field_points: Annotated[int, Between(1, 101)] = 5
    exposure: Exposure | None = None
    luminance: _Luminance = Luminance("200", "cd/m2")

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        if not given.get("scenes"):
            raise OptionError("no scene is given: nolens simulate SCENE -o raw.dng")
        options = super().gather(given)
        if options.fill is not None and options.exposure is not None:
            raise OptionError(
                f"--fill {options.fill} and --exposure {options.exposure} are both given, and each "
                "says how long to expose: leave one out"
            )
        count = len(options.scenes)
        for name, values in (("distance", options.distance), ("angle", options.angle)):
            if len(values) not in (0, 1, count):
                raise OptionError(
                    f"--{name} is given {len(values)} times for {count} scenes: give it once, for "
                    "all of them, or once for each in their order"
                )
        return options

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
            Written(name, path, f"--{name}")
            for name, path in (("truth", self.truth), ("response", self.response))
            if path is not None
        ]
        record = Written("record of the run", self.record)
        return (Written("output", self.output), *more, record)


class PsfOptions(CameraOptions):
    """What `nolens psf` can be told.

    Attributes
    ----------
    angle
        Field angles of the point source, to the right and up as the photographer sees it; `at` is
        another name for it.
    distance
        From the camera; None takes its reference_distance. `depth` is another name for it.
    size
        Its diameter; None takes 50 um, or a point at infinity.
    bin
        Pixels along a cell; None takes the cells of the reconstruction, or all pixels for DNG.
    cells
        (rows, columns) of the result; None takes what the sensor has.
    frame
        Whether the middle of the result follows the ray through the camera's middle or stays on
        the sensor's; None takes the first for TIFF and the second for DNG.
    """

    pictures = (".png",)

    angle: Annotated[FieldAngles, Field(validation_alias=AliasChoices("angle", "at"))] = (
        Angle("0", "deg"),
        Angle("0", "deg"),
    )
    distance: Annotated[Depth | None, Field(validation_alias=AliasChoices("distance", "depth"))] = (
        None
    )
    size: Annotated[Length, Between("0 µm", "10 m")] | None = None
    bin: Bin | None = None
    cells: Annotated[tuple[_Side, _Side], BeforeValidator(_two_sizes)] | None = None
    frame: Literal["chief-ray", "sensor"] | None = None

    @property
    def written(self) -> tuple[Written, ...]:
        """Pattern and record."""
        return (Written("output", self.output), Written("record of the run", self.record))
