"""What `nolens measure field` can be told."""

from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator, Field

from nolens.camera.part import PositiveLength, refusal
from nolens.camera.psf_set import Depth
from nolens.errors import OptionError
from nolens.jobs.fields import FilePath, Name, Seed, record_beside
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Length
from nolens.ranges import Between

_TELLS = {
    "PSFS": ("psfs", "camera", "plot"),
    "--dots": ("dots", "dot_pitch", "distance", "reach", "camera", "plot"),
    "--simulate": (
        "simulate",
        "angles",
        "dot_pitch",
        "distance",
        "reach",
        "seed",
        "plot",
        "output",
    ),
}
_OF_DOTS = ("reach", "output")
_OffAxis = Annotated[Angle, Between("0 deg", "89.9 deg")]
_Reach = Annotated[Angle, Between("0.1 deg", "89.9 deg")]


def _angles(given: Any) -> Any:
    return given.split(",") if isinstance(given, str) else given


def _rising(angles: tuple[Angle, ...]) -> tuple[Angle, ...]:
    degrees = [angle.deg for angle in angles]
    if degrees != sorted(set(degrees)) or not degrees:
        raise refusal("give rising angles from 0deg on, such as 0deg,10deg,20deg")
    return angles


class MeasureFieldOptions(JobOptions):
    """Options of `nolens measure field`.

    Attributes
    ----------
    psfs
        Folder with PSFs that were captured at angles.
    simulate
        Camera that captures them in a simulation, or a grid of dots.
    dots
        Picture of a grid of dots.
    angles
        Of the point sources that are simulated.
    dot_pitch, distance
        Of the grid; the distance also of the point sources (None: the camera's own).
    reach
        Half angle up to which there are dots.
    camera
        That the PSFs or the picture are from; None takes the one in the PSFs' folder, or for a
        picture the paper's.
    seed
        Of the noise.
    plot, output
        Plot, and the picture of the simulated grid.
    """

    psfs: FilePath | None = None
    simulate: Name | None = None
    dots: FilePath | None = None
    angles: Annotated[
        tuple[_OffAxis, ...],
        BeforeValidator(_angles),
        Field(max_length=100),
        AfterValidator(_rising),
    ] = tuple(Angle(str(5 * number), "deg") for number in range(11))
    dot_pitch: PositiveLength | None = None
    distance: Depth | None = None
    reach: _Reach = Angle("50", "deg")
    camera: Name | None = None
    seed: Seed = 0
    plot: FilePath | None = None
    output: FilePath | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If a value cannot be used, or two do not go together.
        """
        options = cls.checked(given)
        named = {"PSFS": options.psfs, "--simulate": options.simulate, "--dots": options.dots}
        sources = [name for name, value in named.items() if value is not None]
        if len(sources) != 1:
            found = "nothing is" if not sources else f"{' and '.join(sources)} are"
            raise OptionError(
                f"{found} given to measure: give one of a folder of PSFs, --simulate CAMERA, or "
                "--dots PICTURE"
            )
        source = sources[0]
        for name in given:
            if name not in _TELLS[source]:
                raise OptionError(f"{_option(name)} means nothing with {source}: leave it out")
        grid = options.dots is not None or options.dot_pitch is not None
        for name in _OF_DOTS:
            if not grid and name in given:
                raise OptionError(f"{_option(name)} is about a grid of dots: give --dot-pitch too")
        if grid and "angles" in given:
            raise OptionError(
                "--angles and --dot-pitch are two things to measure: give one of them at a time"
            )
        if options.dots is not None:
            missing = [each for each in ("dot_pitch", "distance") if getattr(options, each) is None]
            if missing:
                raise OptionError(
                    f"{options.dots} is a grid of dots of unknown size: give "
                    + " and ".join(map(_option, missing))
                    + ", such as --dot-pitch 20mm --distance 300mm"
                )
        if grid and options.distance is not None and not isinstance(options.distance, Length):
            raise OptionError("--distance infinity: a grid of dots needs one, such as 300mm")
        return options

    @property
    def record(self) -> Path | None:
        """File of the run's record, beside the plot or the picture."""
        beside = self.plot or self.output
        return None if beside is None else record_beside(beside)

    @property
    def inputs(self) -> dict[str, Path]:
        """Files that are read, by role, but for the camera's and a folder's."""
        return {} if self.dots is None else {"picture": self.dots}

    @property
    def written(self) -> tuple[Written, ...]:
        """Plot, picture and record."""
        named = (
            ("plot", self.plot, "--plot"),
            ("picture", self.output, "-o"),
            ("record of the run", self.record, "--plot"),
        )
        return tuple(Written(what, path, option) for what, path, option in named if path)


def _option(name: str) -> str:
    return "-o" if name == "output" else f"--{name.replace('_', '-')}"
