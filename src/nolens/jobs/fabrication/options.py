"""What `nolens fabricate` can be told, as a frozen model."""

import re
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, BeforeValidator
from pydantic_core import PydanticCustomError

from nolens.camera import Camera, Package
from nolens.camera.part import PositiveLength
from nolens.errors import OptionError
from nolens.fabricate.levels import MOST_LEVELS
from nolens.fabricate.surface import SurfaceName
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Written
from nolens.quantities import Angle, Length, Share
from nolens.ranges import Between

STUDY_FILE = "tolerance.json"
"""Name of the record that `nolens design tolerance` writes."""
_TWO = re.compile(r"([^x×]+)[x×]([^x×]+)")
_BARE = re.compile(r"[0-9.]+")


def _two_lengths(given: Any) -> Any:
    """Two texts of one like 12.98mmx11.15mm, or 12.98x11.15mm, where both have one unit."""
    if not isinstance(given, str):
        return given
    match = _TWO.fullmatch(given.strip())
    if match is None:
        reason = "give WIDTHxHEIGHT with a unit, such as 12.98x11.15mm"
        raise PydanticCustomError("refused", "{reason}", {"reason": reason})
    first, second = (part.strip() for part in match.groups())
    if _BARE.fullmatch(first):
        first += second.lstrip("0123456789.").strip()
    return first, second


def _study(path: Path) -> Path:
    return path / STUDY_FILE if path.is_dir() else path


TwoLengths = Annotated[tuple[PositiveLength, PositiveLength], BeforeValidator(_two_lengths)]
NotNegativeLength = Annotated[Length, Between("0 mm", "10 m")]
_Shrinkage = Annotated[Share, Between("0 %", "49 %")]


class FabricateOptions(JobOptions):
    """What `nolens fabricate` can be told.

    Attributes
    ----------
    camera
        Preset, folder or .toml file.
    output
        Folder of the files.
    package, glass_top
        Instead of the package that the sensor's description has: its (width, height), and how
        high the top of its glass is.
    wall, clearance, rim, vents, vent_width, vent_depth, mark
        See `FrameGeometry.of`; None leaves a measure to it.
    smallest, bed
        The printer's smallest feature and its bed.
    printer_shrinkage
        Share of its lengths that the print loses: the files are larger by it.
    step
        Whether the frame is written as STEP too.
    crown, contact_angle
        How the resin stands above the frame before the mould is laid on.
    dish, mould_thickness
        Of the mould; None takes a dish 10 mm larger than the frame on every side.
    surface
        Which surface the files of the mask show.
    mould_shrinkage
        Share of its lengths that the mould loses.
    crop
        (width, height) of the middle part of the mask that is written; None for all.
    pitch
        Distance of the points of the mask's files; None takes the relief's.
    levels
        Heights of the layout.
    triangles
        The most that the relief's STL has.
    base
        Thickness under the relief's lowest point.
    tolerances
        Record of a study of tolerances, or its folder, for the budget of the process sheet; None
        takes one from rays.
    """

    camera: Name
    output: FilePath
    package: TwoLengths | None = None
    glass_top: PositiveLength | None = None
    wall: PositiveLength = Length("1", "mm")
    clearance: NotNegativeLength = Length("0.1", "mm")
    rim: NotNegativeLength | None = None
    vents: Annotated[int, Between(0, 1000)] = 4
    vent_width: PositiveLength = Length("0.8", "mm")
    vent_depth: PositiveLength | None = None
    mark: NotNegativeLength | None = None
    smallest: PositiveLength = Length("0.4", "mm")
    bed: TwoLengths = (Length("120", "mm"), Length("68", "mm"))
    printer_shrinkage: _Shrinkage = Share("0", "%")
    step: bool = False
    crown: NotNegativeLength = Length("0.1", "mm")
    contact_angle: Annotated[Angle, Between("0.1 deg", "90 deg")] = Angle("30", "deg")
    dish: TwoLengths | None = None
    mould_thickness: PositiveLength = Length("5", "mm")
    surface: SurfaceName = "master"
    mould_shrinkage: _Shrinkage = Share("0", "%")
    crop: TwoLengths | None = None
    pitch: PositiveLength | None = None
    levels: Annotated[int, Between(2, MOST_LEVELS)] = 16
    triangles: Annotated[int, Between(1, 100_000_000)] = 500_000
    base: PositiveLength = Length("1", "mm")
    tolerances: Annotated[FilePath, AfterValidator(_study)] | None = None

    @classmethod
    def gather(cls, given: dict[str, Any]) -> Self:
        """Options as the command line gives them.

        Raises
        ------
        OptionError
            If one is missing, or its value cannot be used, or two do not go together.
        """
        if not given.get("output"):
            raise OptionError("no output is given; name the folder of the files (-o folder)")
        options = cls.checked(given)
        if (options.package is None) != (options.glass_top is None):
            raise OptionError(
                "--package and --glass-top belong together: give both, such as --package "
                "10.78x8.95mm --glass-top 1.94mm, or neither"
            )
        return options

    @property
    def inputs(self) -> dict[str, Path]:
        """The study of tolerances, beside the camera's own files."""
        return {} if self.tolerances is None else {"tolerances": self.tolerances}

    @property
    def relief_file(self) -> str:
        """Name of the relief's STL, which says which surface it is."""
        return f"relief-{self.surface}.stl"

    @property
    def written(self) -> tuple[Written, ...]:
        """All files in the folder."""
        names = {
            "frame (STL)": "frame.stl",
            "frame (3MF)": "frame.3mf",
            "frame (STEP)": "frame.step" if self.step else None,
            "heights": "mask.tif",
            "layout (GDSII)": "mask.gds",
            "layout (OASIS)": "mask.oas",
            "relief (STL)": self.relief_file,
            "process sheet (HTML)": "sheet.html",
            "process sheet (PDF)": "sheet.pdf",
            "record of the run": "fabricate.json",
        }
        return tuple(Written(what, self.output / name) for what, name in names.items() if name)

    def package_for(self, camera: Camera) -> Package | None:
        """The package as the options or else the camera give it."""
        if self.package is None or self.glass_top is None:
            return camera.sensor.package
        width, height = self.package
        return Package(
            source="given with --package", width=width, height=height, glass_top=self.glass_top
        )
