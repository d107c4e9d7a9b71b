"""Options of `nolens design thickness`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from nolens.camera.part import refusal
from nolens.camera.psf_set import Depth
from nolens.design.uncertain import Uncertain
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.fields import CAMERAS, FilePath, Name
from nolens.jobs.options import JobOptions, Option, Written, expand_home
from nolens.quantities import Length
from nolens.ranges import Between

RECORD_FILE = "thickness.json"
_OF_AIR = "that of air is 1; give one such as 1.47"


def _reading(read: Callable[[Any], Uncertain]) -> BeforeValidator:
    """Read text of the command line."""

    def convert(given: object) -> object:
        if isinstance(given, Uncertain):
            return given
        try:
            return read(given)
        except OptionError as error:
            raise refusal(str(error)) from None

    return BeforeValidator(convert)


@dataclass(frozen=True)
class _Around(Between):
    """Range of a value with its ±, which is no larger than the largest value."""

    def holds(self, value: Uncertain) -> bool:
        """Whether a value lies inside."""
        low, high = (
            Length.parse(each).um if isinstance(each, str) else each
            for each in (self.low, self.high)
        )
        return low <= value.value <= high and value.plus_minus <= high


Thickness = Annotated[Uncertain, _reading(Uncertain.length), _Around("0 mm", "10 m")]
Size = Annotated[Uncertain, _reading(Uncertain.length), _Around("1 nm", "10 m")]
Index = Annotated[Uncertain, _reading(Uncertain.number), _Around(1.0, 4.0, _OF_AIR)]
_SENSOR, _MASTER, _REPLICA = "Sensor", "Master", "Replica"
_LIGHT, _RESULT = "Light", "Result"
_BY_NUMBER = "Its refractive index, in place of a material"
_FILM = ("film", "film_material", "film_index", "film_distance", "film_side")
_GLASS = ("glass", "glass_material", "glass_index")
_ONE_OF = (
    ("film_material", "film_index"),
    ("glass_material", "glass_index"),
    ("material", "index"),
)


class ThicknessOptions(JobOptions):
    """How thick the resin must be on a sensor, and how far off it may be.

    nolens design thickness --film 0.305mm --film-distance 0.4mm+-0.2mm --material pua311

    Put the diffuser over the sensor, find the distance at which the pattern of a point source
    is sharpest, and say it here. Every length and index can have a ±, as in 0.4mm±0.2mm; all
    results then have theirs.
    """

    usage = "design thickness --film 0.305mm --film-distance 0.4mm --material pua311"

    camera: Annotated[
        Name,
        Option(f"Has the layers over the sensor: {CAMERAS}.", _SENSOR, role="camera"),
    ] = "paper"
    glass: Annotated[
        Thickness | None, Option("Thickness of the cover glass.", _SENSOR, default="the camera's")
    ] = None
    glass_material: Annotated[
        Name | None,
        Option(
            "Of the cover glass: a name (nolens material list) or a .toml file.",
            _SENSOR,
            default="the camera's",
            role="material",
        ),
    ] = None
    glass_index: Annotated[Index | None, Option(f"{_BY_NUMBER}.", _SENSOR)] = None
    gap: Annotated[
        Thickness | None,
        Option("Air between glass and sensor.", _SENSOR, default="the camera's"),
    ] = None
    no_glass: Annotated[
        bool,
        Option(
            "The sensor is bare: no glass, and no gap but that of --gap.",
            _SENSOR,
            default="off",
            negative=False,
        ),
    ] = False
    film: Annotated[
        Size | None,
        Option(
            "Thickness of the master film.",
            _MASTER,
            default="0.305mm, with which the paper's figures come out",
        ),
    ] = None
    film_material: Annotated[
        Name | None, Option("Of the film.", _MASTER, default="polycarbonate", role="material")
    ] = None
    film_index: Annotated[Index | None, Option(f"{_BY_NUMBER}.", _MASTER)] = None
    film_distance: Annotated[
        Thickness | None,
        Option(
            "From the film to the cover glass, or the bare sensor, where its pattern is sharpest.",
            _MASTER,
            default="0.4mm±0.2mm, the paper's",
        ),
    ] = None
    film_side: Annotated[
        Literal["scene", "sensor"] | None,
        Option("Where the film's relief faces when that is measured.", _MASTER, default="scene"),
    ] = None
    radius: Annotated[
        Size | None,
        Option(
            "Radius of curvature of the lenslets, where it is known; then no film is needed.",
            _MASTER,
        ),
    ] = None
    material: Annotated[
        tuple[Name, ...],
        Field(max_length=100),
        Option(
            "Of the replica; again for more.",
            _REPLICA,
            default="pdms and pua311, the paper's",
            role="material",
        ),
    ] = ()
    index: Annotated[
        tuple[Index, ...],
        Field(max_length=100),
        Option(f"{_BY_NUMBER}; again for more.", _REPLICA),
    ] = ()
    pitch: Annotated[
        Size | None,
        Option("Distance of neighbouring lenslets.", _REPLICA, default="the camera's"),
    ] = None
    wavelength: Annotated[
        Length,
        Between("1 nm", "1 mm"),
        Option(
            "Of the light that is to be in focus.",
            _LIGHT,
            default="587.56nm, where indices are given",
        ),
    ] = Length("587.56", "nm")
    distance: Annotated[
        Depth,
        Option(
            "From the camera to the point source, in the measurement and in use, or infinity.",
            _LIGHT,
        ),
    ] = "infinity"
    plot: Annotated[
        FilePath | None,
        Option(
            "Picture to write: focus by colour, width of the lines by thickness (.png).",
            _RESULT,
            role="output",
        ),
    ] = None
    output: Annotated[
        FilePath | None,
        Option(
            "Folder to write the camera with this replica into, for nolens psf --camera FOLDER.",
            _RESULT,
            role="output",
            flag="-o",
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse what is said twice, and a camera of several materials."""
        given = [name for name in _FILM if getattr(self, name) is not None]
        if self.radius is not None and given:
            raise OptionError(
                f"--radius and {_option(given[0])} are both given; the radius is either known or "
                "follows from the film: leave one out"
            )
        given = [name for name in _GLASS if getattr(self, name) is not None]
        if self.no_glass and given:
            raise OptionError(f"--no-glass and {_option(given[0])} contradict: leave one out")
        for one, other in _ONE_OF:
            if getattr(self, one) and getattr(self, other):
                raise OptionError(
                    f"{_option(one)} and {_option(other)} are both given, and each says the "
                    "index: leave one out"
                )
        if self.output is not None and len(self.material) + len(self.index) != 1:
            raise OptionError(
                "-o writes one camera, of one material: give one --material or --index"
            )

    @property
    def source_um(self) -> float:
        """Distance of the point source in um."""
        return self.distance.um if isinstance(self.distance, Length) else float("inf")

    @property
    def record(self) -> Path | None:
        """File of the run's record, beside the camera."""
        return None if self.output is None else self.output / RECORD_FILE

    @property
    def output_folder(self) -> Path | None:
        """It is made where it does not exist."""
        return self.output

    @property
    def inputs(self) -> dict[str, Path]:
        """Files of materials, by role."""
        named = {
            "film's material": self.film_material,
            "glass's material": self.glass_material,
            **{f"material {name}": name for name in self.material},
        }
        return {
            role: expand_home(Path(name))
            for role, name in named.items()
            if name is not None and name.lower().endswith(".toml")
        }

    @property
    def written(self) -> tuple[Written, ...]:
        """Plot, camera and record."""
        found = [] if self.plot is None else [Written("plot", self.plot, "--plot", (".png",))]
        if self.output is not None:
            found += [
                Written("camera", self.output / CAMERA_FILE),
                Written("record of the run", self.output / RECORD_FILE),
            ]
        return tuple(found)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
