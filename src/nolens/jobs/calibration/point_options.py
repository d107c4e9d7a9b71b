"""Options of `nolens calibrate`, of frames of a point source."""

from pathlib import Path
from typing import Annotated

from pydantic import Field

from nolens.calibrate.point import StrayLight
from nolens.camera.part import PixelPitch
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import PSFS_FILE
from nolens.jobs.calibration.fields import distance_name
from nolens.jobs.fields import CAMERAS, Exposure, FieldAngles, FilePath, Files, Mosaic, Name
from nolens.jobs.options import JobOptions, Option, Written
from nolens.quantities import Angle

_SOURCE, _FRAMES, _RESULT = "Point source", "Frames", "Result"


class CalibratePointOptions(JobOptions):
    """Make a PSF of pictures of one point source, and add it to a camera's folder.

    nolens calibrate point*.dng --distance 300mm --camera paper -o mycamera

    Once for each place of the point source: the folder gathers the PSFs of all distances and
    angles. Use a white LED behind a pinhole of 50 um in a dark room; more frames make less noise,
    and frames of several exposure times keep the faint parts where the long ones clip.
    """

    usage = "calibrate FRAME... --distance 300mm -o FOLDER"

    frames: Annotated[
        Files,
        Field(min_length=1),
        Option(
            "Camera raw (.dng and others), .tif, .png or .npy, all of the same point source.",
            needed="the frames of one point source (nolens calibrate FRAME... --distance 300mm -o "
            "FOLDER)",
            role="input",
            positional=True,
            label="Frames",
        ),
    ]
    distance: Annotated[
        Depth,
        Option(
            "Of the point source from the camera, such as 300mm, or infinity.",
            _SOURCE,
            needed="that of the point source from the camera (--distance 300mm, or infinity)",
            label="Distance from the mask",
        ),
    ]
    angle: Annotated[
        FieldAngles,
        Option(
            "Field angles of the point source, to the right and up as the photographer sees it, "
            "such as 20deg,-10deg.",
            _SOURCE,
            default="0deg,0deg",
        ),
    ] = (Angle("0", "deg"), Angle("0", "deg"))
    dark: Annotated[
        Files,
        Option(
            "Frames with the point source off, after the others; those of each exposure time are "
            "subtracted from its frames.",
            _FRAMES,
            default="none, and the black level of the files",
            role="input",
            several=True,
            label="Dark frames",
        ),
    ] = ()
    exposure: Annotated[
        tuple[Exposure, ...],
        Field(max_length=100_000),
        Option(
            "Exposure time, such as 10ms: once for all frames, or once for each in their order.",
            _FRAMES,
            default="what the files say",
        ),
    ] = ()
    camera: Annotated[
        Name | None,
        Option(
            f"{CAMERAS}; it is copied into the folder.",
            _FRAMES,
            default="that of the folder, if it has one",
            role="camera",
            label="Description",
        ),
    ] = None
    pixel: Annotated[
        PixelPitch | None,
        Option(
            "Distance of the pixels in the frames, such as 1.55um, where no camera is known.",
            _FRAMES,
        ),
    ] = None
    mosaic: Annotated[
        Mosaic | None, Option("Colour mosaic of frames whose files do not say it.", _FRAMES)
    ] = None
    stray_light: Annotated[
        StrayLight,
        Option(
            "auto subtracts a smooth background where an aperture leaves a dark area, none leaves "
            "all in, floor takes the darkest light there is for stray light.",
            _RESULT,
        ),
    ] = "auto"
    as_is: Annotated[
        bool,
        Option(
            "The frames are a finished PSF, such as another group's: subtract its black level and "
            "nothing else, and warn where frames of a camera would be refused. The middle of the "
            "file is its zero shift.",
            _RESULT,
            default="off",
        ),
    ] = False
    output: Annotated[
        FilePath,
        Option(
            "Folder of the camera's PSFs; made if it is not there. The PSF, the list psfs.toml and "
            "the record calibrate-….json go into it.",
            _RESULT,
            needed="the folder of the camera's PSFs (-o folder)",
            role="output",
            flag="-o",
        ),
    ]

    def check_together(self) -> None:
        """Refuse other times than frames, stray light of a finished PSF, and a frame twice."""
        if len(self.exposure) not in (0, 1, len(self.frames)):
            raise OptionError(
                f"--exposure is given {len(self.exposure)} times for {len(self.frames)} "
                "frames: give it once, for all of them, or once for each in their order"
            )
        if self.as_is and self.stray_light != "auto":
            raise OptionError(
                f"--as-is and --stray-light {self.stray_light} are both given: a PSF that is "
                "taken as it is keeps its stray light. Leave one of them out"
            )
        twice = [path for path in self.frames if self.frames.count(path) > 1]
        both = [path for path in self.dark if path in self.frames]
        if twice or both:
            raise OptionError(
                f"{(twice or both)[0]} is given twice: a frame counts once, as a frame or as a "
                "dark frame"
            )

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
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

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
