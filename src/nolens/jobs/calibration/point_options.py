"""What `nolens calibrate` can be told, as a frozen model."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field

from nolens.calibrate.point import StrayLight
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import PSFS_FILE
from nolens.jobs.fields import Exposure, FieldAngles, FilePath, Files, Mosaic, Name
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Length


class CalibratePointOptions(JobOptions):
    """What `nolens calibrate` can be told.

    Attributes
    ----------
    frames
        Pictures of one point source.
    output
        Folder of the camera's PSFs.
    distance, angle
        Of the point source; the angles are to the right and up as the photographer sees it.
    dark
        Pictures with the light off.
    camera
        Preset, folder or .toml file; None takes that of the folder, if it has one.
    pixel
        Distance of the pixels in the frames; None takes the camera's.
    exposure
        Exposure time of all frames or of each one; none takes what the files say.
    mosaic
        Of frames whose files do not say it.
    stray_light
        What is taken away as light of other sources.
    as_is
        Whether the frames are a finished PSF, of which only the black level is subtracted.
    """

    frames: Files = Field(min_length=1)
    output: FilePath
    distance: Depth
    angle: FieldAngles = (Angle("0", "deg"), Angle("0", "deg"))
    dark: Files = ()
    camera: Name | None = None
    pixel: PixelPitch | None = None
    exposure: Annotated[tuple[Exposure, ...], Field(max_length=100_000)] = ()
    mosaic: Mosaic | None = None
    stray_light: StrayLight = "auto"
    as_is: bool = False

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        if not given.get("frames"):
            raise OptionError(
                "no frame is given: nolens calibrate FRAME... --distance 300mm -o FOLDER"
            )
        if not given.get("output"):
            raise OptionError(
                "no output is given; name the folder of the camera's PSFs (-o folder)"
            )
        if not given.get("distance"):
            raise OptionError(
                "no distance is given: say how far the point source was from the camera "
                "(--distance 300mm, or infinity)"
            )
        options = cls.checked(given)
        if len(options.exposure) not in (0, 1, len(options.frames)):
            raise OptionError(
                f"--exposure is given {len(options.exposure)} times for {len(options.frames)} "
                "frames: give it once, for all of them, or once for each in their order"
            )
        if options.as_is and options.stray_light != "auto":
            raise OptionError(
                f"--as-is and --stray-light {options.stray_light} are both given: a PSF that is "
                "taken as it is keeps its stray light. Leave one of them out"
            )
        twice = [path for path in options.frames if options.frames.count(path) > 1]
        both = [path for path in options.dark if path in options.frames]
        if twice or both:
            raise OptionError(
                f"{(twice or both)[0]} is given twice: a frame counts once, as a frame or as a "
                "dark frame"
            )
        return options

    @property
    def suffix(self) -> str:
        """Distance and angle, as the names of files have them."""
        text = distance_name(self.distance)
        if any(each.deg != 0 for each in self.angle):
            text += "".join(f"-{each.deg:.6g}deg" for each in self.angle)
        return text

    @property
    def psf(self) -> Path:
        """File of the PSF."""
        return self.output / f"psf-{self.suffix}.tif"

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / f"calibrate-{self.suffix}.json"

    @property
    def inputs(self) -> dict[str, Path]:
        """Frames and dark frames, by role."""
        return {
            f"{role} {number}": path
            for role, paths in (("frame", self.frames), ("dark frame", self.dark))
            for number, path in enumerate(paths, start=1)
        }

    @property
    def written(self) -> tuple[Written, ...]:
        """PSF, list and record."""
        return (
            Written("PSF", self.psf),
            Written("list of PSFs", self.output / PSFS_FILE),
            Written("record of the run", self.record),
        )


def distance_name(distance: Length | Literal["infinity"]) -> str:
    """A distance as the names of files have it, the same for 30 cm and 300 mm."""
    return f"{distance.mm:.6g}mm" if isinstance(distance, Length) else distance
