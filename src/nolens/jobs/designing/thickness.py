"""`nolens design thickness`: how thick a replica must be, with the error of everything."""

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from nolens.camera import LoadedCamera, RandomLenslets
from nolens.camera.psf_set import Depth
from nolens.design.thickness import (
    Master,
    Medium,
    ReplicaDesign,
    ThicknessCase,
    cover_layers,
    thickness_summary,
)
from nolens.design.uncertain import Around, Uncertain
from nolens.errors import OptionError
from nolens.files import CAMERA_FILE, read_material
from nolens.files.cameras import write_description
from nolens.files.plot_design import plot_thickness
from nolens.jobs.fields import CAMERAS, FilePath, Name
from nolens.jobs.options import RECORD, JobOptions, Option, Written, expand_home
from nolens.jobs.run import Product, Run, Writer, job
from nolens.quantities import Length
from nolens.ranges import Between

_RECORD_FILE = "thickness.json"
_OF_AIR = "that of air is 1; give one such as 1.47"
_PAPER_FILM = Uncertain(305.0)
"""0.012 inch; the paper gives no thickness, and with this one its figures come out."""
_PAPER_FILM_MATERIAL = "polycarbonate"
_PAPER_DISTANCE = Uncertain(400.0, 200.0)
_PAPER_REPLICAS = ("pdms", "pua311")


_Thickness = Annotated[Uncertain, Around("0 mm", "10 m")]
_Size = Annotated[Uncertain, Around("1 nm", "10 m")]
_Index = Annotated[Uncertain, Around(1.0, 4.0, _OF_AIR)]
_SENSOR, _MASTER, _REPLICA = "Sensor", "Master", "Replica"
_LIGHT = "Light"
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

    Put the diffuser over the sensor, find the distance at which the PSF is sharpest, and give
    it here. Every length and index can have a ±, as in 0.4mm±0.2mm; all
    results then have theirs.
    """

    usage = "design thickness --film 0.305mm --film-distance 0.4mm --material pua311"

    camera: Annotated[
        Name,
        Option(f"Camera whose sensor is covered: {CAMERAS}.", role="camera"),
    ] = "paper"
    glass: Annotated[
        _Thickness | None, Option("Thickness of the cover glass.", _SENSOR, default="the camera's")
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
    glass_index: Annotated[_Index | None, Option(f"{_BY_NUMBER}.", _SENSOR)] = None
    gap: Annotated[
        _Thickness | None,
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
        _Size | None,
        Option(
            "Thickness of the film whose relief is copied, the master.",
            default="0.305mm, with which the paper's figures come out",
        ),
    ] = None
    film_material: Annotated[
        Name | None, Option("Of the film.", _MASTER, default="polycarbonate", role="material")
    ] = None
    film_index: Annotated[_Index | None, Option(f"{_BY_NUMBER}.", _MASTER)] = None
    film_distance: Annotated[
        _Thickness | None,
        Option(
            "Distance from the film to the cover glass, or the bare sensor, at which the PSF is "
            "sharpest.",
            default="0.4mm±0.2mm, the paper's",
        ),
    ] = None
    film_side: Annotated[
        Literal["scene", "sensor"] | None,
        Option("Where the film's relief faces when that is measured.", _MASTER, default="scene"),
    ] = None
    radius: Annotated[
        _Size | None,
        Option(
            "Radius of curvature of the lenslets, where it is known; then no film is needed.",
            _MASTER,
        ),
    ] = None
    material: Annotated[
        tuple[Name, ...],
        Field(max_length=100),
        Option(
            "Material of the replica: a name (nolens material list) or a .toml file; again for "
            "more.",
            default="pdms and pua311, the paper's",
            role="material",
        ),
    ] = ()
    index: Annotated[
        tuple[_Index, ...],
        Field(max_length=100),
        Option(f"{_BY_NUMBER}; again for more.", _REPLICA),
    ] = ()
    pitch: Annotated[
        _Size | None,
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
            role="output",
        ),
    ] = None
    output: Annotated[
        FilePath | None,
        Option(
            "Folder to write the camera with this replica into, for nolens psf --camera FOLDER.",
            role="output",
            flag="-o",
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse what is said twice, and a camera of several materials."""
        of_film = [name for name in _FILM if getattr(self, name) is not None]
        if self.radius is not None and of_film:
            raise OptionError(
                f"--radius and {self.flag(of_film[0])} are both given; the radius is either known "
                "or follows from the film: leave one out"
            )
        of_glass = [name for name in _GLASS if getattr(self, name) is not None]
        if self.no_glass and of_glass:
            raise OptionError(f"--no-glass and {self.flag(of_glass[0])} contradict: leave one out")
        for one, other in _ONE_OF:
            if getattr(self, one) and getattr(self, other):
                raise OptionError(
                    f"{self.flag(one)} and {self.flag(other)} are both given, and each says the "
                    "index: leave one out"
                )
        if self.output is not None and len(self.material) + len(self.index) != 1:
            raise OptionError(
                "-o writes one camera, of one material: give one --material or --index"
            )

    @property
    def record(self) -> Path | None:
        """File of the run's record, beside the camera."""
        return None if self.output is None else self.output / _RECORD_FILE

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
        files = [] if self.plot is None else [Written("plot", self.plot, "--plot", (".png",))]
        if self.output is not None:
            files += [
                Written("camera", self.output / CAMERA_FILE),
                Written(RECORD, self.output / _RECORD_FILE),
            ]
        return tuple(files)


def read_case(
    options: ThicknessOptions, loaded: LoadedCamera
) -> tuple[ThicknessCase, tuple[Medium, ...]]:
    """Read the materials: what is asked about a camera, and of what replicas.

    Raises
    ------
    NolensError
        If one cannot be read, or the options do not fit the camera.
    """
    master: Master | Uncertain
    if options.radius is not None:
        master = options.radius
    else:
        master = Master(
            _medium(options.film_material or _PAPER_FILM_MATERIAL, options.film_index),
            options.film or _PAPER_FILM,
            options.film_distance or _PAPER_DISTANCE,
            options.film_side or "scene",
            assumed=options.film is None and options.film_distance is None,
        )
    names = options.material or (() if options.index else _PAPER_REPLICAS)
    replicas = (
        *(Medium.of_index(index) for index in options.index),
        *(Medium.of_material(read_material(name)) for name in names),
    )
    pitch, rounding = _lenslets(loaded, options)
    glass_medium = None
    if options.glass_material or options.glass_index:
        glass_medium = _medium(options.glass_material or "", options.glass_index)
    cover = cover_layers(
        loaded,
        bare=options.no_glass,
        glass=options.glass,
        glass_medium=glass_medium,
        gap=options.gap,
    )
    source_um = options.distance.um if isinstance(options.distance, Length) else math.inf
    case = ThicknessCase(loaded, cover, master, pitch, rounding, options.wavelength, source_um)
    return case, replicas


def _medium(material: str, index: Uncertain | None) -> Medium:
    """A material by name or from a file, but where an index is given, one of that."""
    return Medium.of_index(index) if index else Medium.of_material(read_material(material))


def _lenslets(loaded: LoadedCamera, options: ThicknessOptions) -> tuple[Uncertain, float]:
    """Pitch, and the fraction of it that rounds the valleys."""
    relief = loaded.camera.mask.relief
    if isinstance(relief, RandomLenslets):
        pitch = options.pitch or Uncertain(relief.pitch.um)
        return pitch, relief.smoothing.um / relief.pitch.um
    if options.pitch is None:
        raise OptionError(
            f"the relief of {loaded.camera.name!r} is not described by a pitch: give the distance "
            "of its lenslets, such as --pitch 70um"
        )
    return options.pitch, 0.0


@job
def design_thickness(run: Run[ThicknessOptions]) -> Product[tuple[ReplicaDesign, ...]]:
    """Find the thickness of each replica, and write what was asked for.

    Raises
    ------
    NolensError
        If an input or an option cannot be used, or a material cannot focus on this sensor; then
        nothing is written.
    """
    options = run.options
    case, media = read_case(options, run.camera(options.camera))
    run.begin()
    designs = tuple(ReplicaDesign.of(case, medium) for medium in media)
    writers: dict[Path, Writer] = {}
    if options.plot is not None:
        curves = [each.curves() for each in designs]
        writers[options.plot] = partial(plot_thickness, materials=curves)
    if options.output is not None:
        camera = designs[0].camera()
        writers[options.output / CAMERA_FILE] = partial(write_description, camera=camera)
    return Product(designs, thickness_summary(designs), writers)
