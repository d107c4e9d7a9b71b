"""What `nolens calibrate stitch` and `nolens calibrate plan` can be told, as frozen models."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BeforeValidator
from pydantic_core import PydanticCustomError

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, FullAngle, Name
from nolens.jobs.options import JobOptions, Written


class CalibrateStitchOptions(JobOptions):
    """What `nolens calibrate stitch` can be told.

    Attributes
    ----------
    folder
        Of the camera's PSFs; the result is added to it.
    distance
        Of the point source; None takes the only one that was captured at angles.
    reduced
        Reduced thickness between mask and sensor, where the folder has no camera.toml.
    """

    folder: FilePath
    distance: Depth | None = None
    reduced: PositiveLength | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("folder"):
            raise OptionError("no folder is given: nolens calibrate stitch FOLDER")
        return cls.checked(given)

    @property
    def inputs(self) -> dict[str, Path]:
        """Nothing but what the folder lists."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """Nothing outside the folder."""
        return ()


def _one_or_two(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    parts = given.split(",")
    if len(parts) > 2:
        reason = "give the angle that the scene fills, or width and height: 56deg or 56deg,42deg"
        raise PydanticCustomError("refused", "{reason}", {"reason": reason})
    return parts[0], parts[-1]


class CalibratePlanOptions(JobOptions):
    """What `nolens calibrate plan` can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    angle
        Field angles that the scene's width and height fill.
    """

    camera: Name = "paper"
    angle: Annotated[tuple[FullAngle, FullAngle], BeforeValidator(_one_or_two)]

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used.
        """
        if not given.get("angle"):
            raise OptionError(
                "no angle is given: say which angle the scene fills (--angle 56deg, or width and "
                "height: --angle 56deg,42deg)"
            )
        return cls.checked(given)

    @property
    def inputs(self) -> dict[str, Path]:
        """Nothing but the camera."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """Nothing."""
        return ()
