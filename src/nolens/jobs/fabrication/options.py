"""Options of `nolens fabricate`."""

import re
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator

from nolens.camera import Camera, Package
from nolens.camera.part import PositiveLength, refusal
from nolens.errors import OptionError
from nolens.fabricate import MOST_LEVELS, SurfaceName
from nolens.jobs.fields import FilePath, Name
from nolens.jobs.options import JobOptions, Option, Written
from nolens.quantities import Angle, Length, Share
from nolens.ranges import Between

STUDY_FILE = "tolerance.json"
"""Name of the record that `nolens design tolerance` writes."""
RECORD_FILE = "fabricate.json"
_FRAME, _PRINTER, _AMOUNTS = "Frame", "Printer", "Resin and mould"
_MASK, _SHEET = "Mask", "Process sheet"
_TWO = re.compile(r"([^x×]+)[x×]([^x×]+)")
_BARE = re.compile(r"[0-9.]+")


def _two_lengths(given: Any) -> Any:
    """Two texts of one like 12.98mmx11.15mm, or 12.98x11.15mm, where both have one unit."""
    if not isinstance(given, str):
        return given
    match = _TWO.fullmatch(given.strip())
    if match is None:
        raise refusal("give WIDTHxHEIGHT with a unit, such as 12.98x11.15mm")
    first, second = (part.strip() for part in match.groups())
    if _BARE.fullmatch(first):
        first += second.lstrip("0123456789.").strip()
    return first, second


def _study(path: Path) -> Path:
    return path / STUDY_FILE if path.is_dir() else path


TwoLengths = Annotated[tuple[PositiveLength, PositiveLength], BeforeValidator(_two_lengths)]
NotNegativeLength = Annotated[Length, Between("0 mm", "10 m")]
_Study = Annotated[FilePath, AfterValidator(_study)]
_Shrinkage = Annotated[Share, Between("0 %", "49 %")]


class FabricateOptions(JobOptions):
    """Write the files that a camera is made from: frame, mask, process sheet.

    nolens fabricate paper -o workshop

    Lengths, angles and fractions are given with their unit: 1.06mm, 30deg, 0.5%.
    """

    usage = "fabricate CAMERA -o FOLDER"

    camera: Annotated[
        Name,
        Option(
            "paper, small, a folder with camera.toml, or a .toml file; its mask is resin poured "
            "onto the cover glass.",
            needed="the camera (nolens fabricate CAMERA -o FOLDER)",
            role="camera",
            positional=True,
            label="Description",
        ),
    ]
    output: Annotated[
        FilePath,
        Option(
            "Folder of the files, made where it is missing: frame.stl and frame.3mf, mask.tif "
            "(16-bit heights), mask.gds and mask.oas (levels), relief-SURFACE.stl, sheet.html and "
            "sheet.pdf for the bench, and fabricate.json, the record with all figures.",
            needed="the folder of the files (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    package: Annotated[
        TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the sensor's package, along its rows and across.",
            _FRAME,
            default="the camera's sensor.package",
        ),
    ] = None
    glass_top: Annotated[
        PositiveLength | None,
        Option("From the board up to the top of the package; with --package.", _FRAME),
    ] = None
    wall: Annotated[PositiveLength, Option("Thickness of the frame's wall.", _FRAME)] = Length(
        "1", "mm"
    )
    clearance: Annotated[
        NotNegativeLength, Option("Between the package and the frame, on every side.", _FRAME)
    ] = Length("0.1", "mm")
    rim: Annotated[
        NotNegativeLength | None,
        Option(
            "Legs of the 45° cut along the inside top edge, which takes up resin; 0mm for none.",
            _FRAME,
            default="0.3 of the wall",
        ),
    ] = None
    vents: Annotated[
        int,
        Between(0, 1000),
        Option("Channels across the wall's top, through which air and resin leave.", _FRAME),
    ] = 4
    vent_width: Annotated[PositiveLength, Option("Of a channel.", _FRAME)] = Length("0.8", "mm")
    vent_depth: Annotated[
        PositiveLength | None,
        Option("Of a channel.", _FRAME, default="0.25mm, or a quarter of a thinner resin"),
    ] = None
    mark: Annotated[
        NotNegativeLength | None,
        Option(
            "Legs of the outer corner that is cut off at pixel (0, 0); 0mm for none.",
            _FRAME,
            default="0.8 of the wall",
        ),
    ] = None
    step: Annotated[
        bool, Option("Writes frame.step too; needs nolens[step].", _FRAME, default="off")
    ] = False
    smallest: Annotated[
        PositiveLength,
        Option("The thinnest wall and narrowest channel that the printer makes.", _PRINTER),
    ] = Length("0.4", "mm")
    bed: Annotated[
        TwoLengths,
        Option("WIDTHxDEPTH of the printer's bed.", _PRINTER, default="120x68mm"),
    ] = (Length("120", "mm"), Length("68", "mm"))
    printer_shrinkage: Annotated[
        _Shrinkage,
        Option(
            "Fraction of its lengths that a print loses; the frame's files are larger by it.",
            _PRINTER,
        ),
    ] = Share("0", "%")
    crown: Annotated[
        NotNegativeLength,
        Option(
            "How high the poured resin's middle stands above the frame, so that the mould meets "
            "it first.",
            _AMOUNTS,
        ),
    ] = Length("0.1", "mm")
    contact_angle: Annotated[
        Angle,
        Between("0.1 deg", "90 deg"),
        Option("At which the resin runs over the wall's top.", _AMOUNTS),
    ] = Angle("30", "deg")
    dish: Annotated[
        TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the dish that the mould is cast in.",
            _AMOUNTS,
            default="10mm more than the frame on every side",
        ),
    ] = None
    mould_thickness: Annotated[PositiveLength, Option("Of the mould.", _AMOUNTS)] = Length(
        "5", "mm"
    )
    surface: Annotated[
        SurfaceName,
        Option(
            "What the mask's files show: the master that the mould is taken from, the mould "
            "(mirrored and inverted), or the replica on the camera.",
            _MASK,
        ),
    ] = "master"
    mould_shrinkage: Annotated[
        _Shrinkage,
        Option("Fraction of its lengths that the mould loses; the master is larger by it.", _MASK),
    ] = Share("0", "%")
    crop: Annotated[
        TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the middle part of the mask that is written, such as 1x1mm.",
            _MASK,
            default="all of it",
        ),
    ] = None
    pitch: Annotated[
        PositiveLength | None,
        Option("Distance of the points in mask.tif, .gds and .oas.", _MASK, default="the relief's"),
    ] = None
    levels: Annotated[
        int,
        Between(2, MOST_LEVELS),
        Option(
            "Heights of the layout, each a layer: layer k is all that is k steps high or higher.",
            _MASK,
        ),
    ] = 16
    triangles: Annotated[
        int, Between(1, 100_000_000), Option("The most that relief-SURFACE.stl has.", _MASK)
    ] = 500_000
    base: Annotated[
        PositiveLength,
        Option("Thickness under the lowest point of the relief in the STL.", _MASK),
    ] = Length("1", "mm")
    tolerances: Annotated[
        _Study | None,
        Option(
            "Folder that nolens design tolerance wrote for this camera, or the record in it, for "
            "the budget of the process sheet.",
            _SHEET,
            default="a budget from rays",
            role="input",
        ),
    ] = None

    def check_together(self) -> None:
        """Refuse half of a package."""
        if (self.package is None) != (self.glass_top is None):
            raise OptionError(
                "--package and --glass-top belong together: give both, such as --package "
                "10.78x8.95mm --glass-top 1.94mm, or neither"
            )

    @property
    def relief_file(self) -> str:
        """Name of the relief's STL, which says which surface it is."""
        return f"relief-{self.surface}.stl"

    @property
    def record(self) -> Path:
        """File of the run's record."""
        return self.output / RECORD_FILE

    @property
    def output_folder(self) -> Path:
        """It is made where it does not exist."""
        return self.output

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
            "record of the run": RECORD_FILE,
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
