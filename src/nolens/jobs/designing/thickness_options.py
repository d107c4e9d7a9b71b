"""What `nolens design thickness` can be told, as a frozen model."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field
from pydantic_core import PydanticCustomError

from nolens.camera.psf_set import Depth
from nolens.design.uncertain import Uncertain
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Written, expand_home
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
            raise PydanticCustomError("quantity", "{reason}", {"reason": str(error)}) from None

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
_FILM = ("film", "film_material", "film_index", "film_distance", "film_side")
_GLASS = ("glass", "glass_material", "glass_index")
_ONE_OF = (
    ("film_material", "film_index"),
    ("glass_material", "glass_index"),
    ("material", "index"),
)


class ThicknessOptions(JobOptions):
    """What `nolens design thickness` can be told; lengths and indices with or without ±.

    Attributes
    ----------
    camera
        Preset, folder or .toml file that has the layers over the sensor.
    glass, gap
        Thickness of the cover glass and of the air below it, in place of the camera's.
    glass_material, glass_index
        What the glass is made of, in place of the camera's.
    no_glass
        The sensor has no cover glass; then the camera's gap counts no more, either.
    film, film_material, film_index, film_distance, film_side
        The master: its thickness (None: the paper's), what it is made of, where it is sharpest
        over the cover glass or bare sensor (None: the paper's), and where its relief faces.
    radius
        Radius of curvature of the lenslets, in place of a film.
    material, index
        Of the replica: names or .toml files, or numbers; several make a table. Neither: the
        paper's two materials.
    pitch
        Of the lenslets; None takes the camera's.
    wavelength
        Of the light.
    distance
        From the camera to the point source.
    plot
        Picture to write.
    output
        Folder of the camera to write.
    """

    camera: Name = "paper"
    glass: Thickness | None = None
    glass_material: Name | None = None
    glass_index: Index | None = None
    gap: Thickness | None = None
    no_glass: bool = False
    film: Size | None = None
    film_material: Name | None = None
    film_index: Index | None = None
    film_distance: Thickness | None = None
    film_side: Literal["scene", "sensor"] | None = None
    radius: Size | None = None
    material: Annotated[tuple[Name, ...], Field(max_length=100)] = ()
    index: Annotated[tuple[Index, ...], Field(max_length=100)] = ()
    pitch: Size | None = None
    wavelength: Annotated[Length, Between("1 nm", "1 mm")] = Length("587.56", "nm")
    distance: Depth = "infinity"
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
        options._check_together()
        if options.output is not None and len(options.material) + len(options.index) != 1:
            raise OptionError(
                "-o writes one camera, of one material: give one --material or --index"
            )
        return options

    def _check_together(self) -> None:
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

    @property
    def source_um(self) -> float:
        """Distance of the point source in um."""
        return self.distance.um if isinstance(self.distance, Length) else float("inf")

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
        found = [] if self.plot is None else [Written("plot", self.plot, "--plot")]
        if self.output is not None:
            found += [
                Written("camera", self.output / CAMERA_FILE),
                Written("record of the run", self.output / RECORD_FILE),
            ]
        return tuple(found)


def _option(name: str) -> str:
    return f"--{name.replace('_', '-')}"
