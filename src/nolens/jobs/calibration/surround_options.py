"""What `nolens calibrate surround` can be told, as a frozen model."""

from pathlib import Path
from typing import Annotated, Any, Self

from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, Files, Window
from nolens.jobs.options import JobOptions, Written
from nolens.ranges import Between


class CalibrateSurroundOptions(JobOptions):
    """What `nolens calibrate surround` can be told.

    Attributes
    ----------
    folder
        Of the camera's PSFs; the result is added to it.
    pictures
        Raw frames of ordinary scenes.
    region
        HEIGHTxWIDTH in cells, and +TOP+LEFT: where their light comes from.
    distance
        Of the captured PSF; None takes the only one.
    rounds
        Turns of scenes and PSF.
    """

    folder: FilePath
    pictures: Files = ()
    region: Window
    distance: Depth | None = None
    rounds: Annotated[int, Between(1, 100)] = 4

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("folder"):
            raise OptionError(
                "no folder is given: nolens calibrate surround FOLDER RAW... --region 414x414"
            )
        if not given.get("region"):
            raise OptionError(
                "no region is given: say where light comes from, in cells (--region 414x414; "
                "nolens calibrate plan CAMERA --angle 56deg tells it for an angle)"
            )
        options = cls.checked(given)
        if len(set(options.pictures)) < len(options.pictures):
            raise OptionError("a picture is given twice: it counts once")
        return options

    @property
    def inputs(self) -> dict[str, Path]:
        """Pictures, by role."""
        return {f"picture {number}": path for number, path in enumerate(self.pictures, start=1)}

    @property
    def written(self) -> tuple[Written, ...]:
        """Nothing outside the folder."""
        return ()
