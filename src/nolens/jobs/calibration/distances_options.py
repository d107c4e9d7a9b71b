"""What `nolens calibrate distances` can be told, as a frozen model."""

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from nolens.camera.part import PositiveLength
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.files import PSFS_FILE
from nolens.jobs.calibration.point_options import distance_name
from nolens.jobs.fields import Distances, FilePath
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Length
from nolens.ranges import Between

_DIGITS = 5
RECORD_FILE = "distances.json"
"""Name of the record in the folder."""


def _two(given: Any) -> Any:
    if not isinstance(given, str):
        return given
    parts = [part.strip() for part in given.split(",")]
    if len(parts) != 2:
        reason = "give two distances, such as 8cm,1m or 8cm,infinity"
        raise PydanticCustomError("refused", "{reason}", {"reason": reason})
    return tuple(parts)


class CalibrateDistancesOptions(JobOptions):
    """What `nolens calibrate distances` can be told.

    Attributes
    ----------
    folder
        Of the camera's PSFs.
    at
        Distances that PSFs are wanted at.
    between, count
        The nearest and the farthest of several distances, and how many; equal steps of 1/z.
    source
        Distance of the PSF that all come from; None takes the nearest one, in 1/z.
    reduced
        Reduced thickness between mask and sensor, where the folder has no camera.toml.
    """

    folder: FilePath
    at: Distances = ()
    between: Annotated[tuple[Depth, Depth], BeforeValidator(_two)] | None = None
    count: Annotated[int, Between(2, 1000)] | None = None
    source: Depth | None = Field(default=None, alias="from")
    reduced: PositiveLength | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        if not given.get("folder"):
            raise OptionError(
                "no folder is given: nolens calibrate distances FOLDER --at 8cm --at 20cm"
            )
        if not given.get("at") and not given.get("between"):
            raise OptionError(
                "no distance is given: say which PSFs are wanted (--at 8cm --at infinity, or "
                "--between 8cm,1m --count 8)"
            )
        options = cls.checked(given)
        if (options.between is None) != (options.count is None):
            raise OptionError("--between and --count go together: --between 8cm,1m --count 8")
        names = [distance_name(each) for each in options.distances]
        for each in names:
            if names.count(each) > 1:
                raise OptionError(f"the distance {each} is given twice: give it once")
        return options

    @property
    def distances(self) -> tuple[Length | Literal["infinity"], ...]:
        """All distances that PSFs are wanted at."""
        if self.between is None or self.count is None:
            return self.at
        ends = [0.0 if isinstance(each, str) else 1 / each.mm for each in self.between]
        if ends[0] <= ends[1]:
            raise OptionError(
                f"--between {self.between[0]},{self.between[1]}: give the nearer distance first, "
                "such as 8cm,1m"
            )
        steps = [
            ends[0] + (ends[1] - ends[0]) * number / (self.count - 1)
            for number in range(1, self.count - 1)
        ]
        inner = [Length.of(float(f"{1 / each:.{_DIGITS}g}"), "mm") for each in steps]
        return (*self.at, self.between[0], *inner, self.between[1])

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.folder / RECORD_FILE

    @property
    def inputs(self) -> dict[str, Path]:
        """Nothing but what the folder lists."""
        return {}

    @property
    def written(self) -> tuple[Written, ...]:
        """PSFs, list and record."""
        return (
            *(
                Written(f"PSF of {distance}", self.folder / psf_file(distance), "--at")
                for distance in self.distances
            ),
            Written("list of PSFs", self.folder / PSFS_FILE),
            Written("record of the run", self.record),
        )


def psf_file(distance: Length | Literal["infinity"]) -> str:
    """Name of a scaled PSF's file."""
    return f"scaled-{distance_name(distance)}.tif"
