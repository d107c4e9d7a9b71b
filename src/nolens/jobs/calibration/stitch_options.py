"""What `nolens calibrate stitch` and `nolens calibrate plan` can be told, as frozen models."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.given import JobOptions, Written, expand_home
from nolens.quantities import Angle


class CalibrateStitchOptions(JobOptions):
    """What `nolens calibrate stitch` can be told.

    Attributes
    ----------
    folder
        Of the camera's PSFs; the result is added to it.
    distance
        Of the point of light; None takes the only one that was captured at angles.
    reduced
        Reduced thickness between mask and sensor, where the folder has no camera.toml.
    """

    folder: Annotated[Path, AfterValidator(expand_home)]
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


def _fills(given: tuple[Angle, Angle]) -> tuple[Angle, Angle]:
    if any(not 0 < each.deg < 180 for each in given):
        reason = "it must be more than zero and less than 180 deg, such as 56deg"
        raise PydanticCustomError("refused", "{reason}", {"reason": reason})
    return given


class CalibratePlanOptions(JobOptions):
    """What `nolens calibrate plan` can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    angle
        Field angles that the scene's width and height fill.
    """

    camera: str = "paper"
    angle: Annotated[tuple[Angle, Angle], BeforeValidator(_one_or_two), AfterValidator(_fills)]

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
