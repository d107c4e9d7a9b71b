"""`nolens fabricate`: a camera's files for the workshop: frame, mask, amounts, process sheet."""

import re
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar

from pydantic import AfterValidator, BeforeValidator

from nolens.camera import Camera, Flat, Package
from nolens.camera.part import PositiveLength, refusal
from nolens.design.masks import quarter_um
from nolens.errors import OptionError
from nolens.fabricate import (
    MOST_LEVELS,
    FrameGeometry,
    MouldAmount,
    Printer,
    ResinAmount,
    SurfaceName,
    Wetting,
    Workpieces,
    made_surface,
    process_sheet,
)
from nolens.files import check_height_map, check_step, workpiece_writers
from nolens.files.pdf import write_sheet_pdf
from nolens.files.sheet import write_sheet_html
from nolens.files.tolerances import RECORD_FILE, study_budget
from nolens.jobs.fields import FilePath, Name, OutputFolderOptions
from nolens.jobs.options import Option, Written
from nolens.jobs.run import Product, Reporter, Run, Writer, job
from nolens.machine import BYTES_OF_PROGRAM
from nolens.quantities import Angle, Length, Percentage
from nolens.ranges import Between
from nolens.twin import Twin, relief_points

_FRAME, _PRINTER, _AMOUNTS = "Frame", "Printer", "Resin and mould"
_MASK, _SHEET = "Mask", "Process sheet"
_TWO = re.compile(r"([^x×]+)[x×]([^x×]+)")
_BARE = re.compile(r"[0-9.]+")
_BYTES_PER_POINT = 30.0


def _two_lengths(value: Any) -> Any:
    """Two texts of one like 12.98mmx11.15mm, or 12.98x11.15mm, where both have one unit."""
    if not isinstance(value, str):
        return value
    match = _TWO.fullmatch(value.strip())
    if match is None:
        raise refusal("give WIDTHxHEIGHT with a unit, such as 12.98x11.15mm")
    first, second = (part.strip() for part in match.groups())
    if _BARE.fullmatch(first):
        first += second.lstrip("0123456789.").strip()
    return first, second


def _study(path: Path) -> Path:
    """The record that `nolens design tolerance` wrote into a folder, or the file that is named."""
    return path / RECORD_FILE if path.is_dir() else path


_TwoLengths = Annotated[tuple[PositiveLength, PositiveLength], BeforeValidator(_two_lengths)]
_NotNegativeLength = Annotated[Length, Between("0 mm", "10 m")]
_Study = Annotated[FilePath, AfterValidator(_study)]
_Shrinkage = Annotated[Percentage, Between("0 %", "49 %")]


class FabricateOptions(OutputFolderOptions):
    """Write the files that a camera is made from: frame, mask, process sheet.

    nolens fabricate paper -o workshop

    Lengths, angles and fractions are given with their unit: 1.06mm, 30deg, 0.5%.
    """

    usage = "fabricate CAMERA -o FOLDER"
    record_file: ClassVar[str] = "fabricate.json"

    camera: Annotated[
        Name,
        Option(
            "Camera to make: paper, small, a folder with camera.toml, or a .toml file; its mask is "
            "resin poured onto the cover glass.",
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
            "sheet.pdf for the workshop, and fabricate.json, the record with all figures.",
            needed="the folder of the files (-o folder)",
            role="output",
            flag="-o",
        ),
    ]
    package: Annotated[
        _TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the sensor's package, along its rows and across, such as "
            "12.98x11.15mm.",
            default="the camera's sensor.package",
            label="Package of the sensor",
        ),
    ] = None
    glass_top: Annotated[
        PositiveLength | None,
        Option(
            "Height from the board up to the top of the package; with --package.",
            label="Height of the package",
        ),
    ] = None
    wall: Annotated[
        PositiveLength,
        Option("Thickness of the frame's wall.", _FRAME, label="Thickness of the wall"),
    ] = Length("1", "mm")
    clearance: Annotated[
        _NotNegativeLength,
        Option(
            "Between the package and the frame, on every side.",
            _FRAME,
            label="Clearance around the package",
        ),
    ] = Length("0.1", "mm")
    rim: Annotated[
        _NotNegativeLength | None,
        Option(
            "Legs of the 45° cut along the inside top edge, which takes up resin; 0mm for none.",
            _FRAME,
            default="0.3 of the wall",
            label="Cut along the inside edge",
        ),
    ] = None
    vents: Annotated[
        int,
        Between(0, 1000),
        Option(
            "Channels across the wall's top, through which air and resin leave.",
            _FRAME,
            label="Vents",
        ),
    ] = 4
    vent_width: Annotated[
        PositiveLength, Option("Of a channel.", _FRAME, label="Width of a vent")
    ] = Length("0.8", "mm")
    vent_depth: Annotated[
        PositiveLength | None,
        Option(
            "Of a channel.",
            _FRAME,
            default="0.25mm, or a quarter of a thinner resin",
            label="Depth of a vent",
        ),
    ] = None
    mark: Annotated[
        _NotNegativeLength | None,
        Option(
            "Legs of the outer corner that is cut off at pixel (0, 0); 0mm for none.",
            _FRAME,
            default="0.8 of the wall",
            label="Cut corner",
        ),
    ] = None
    step: Annotated[
        bool, Option("Writes frame.step too; needs nolens[step].", _FRAME, default="off")
    ] = False
    smallest: Annotated[
        PositiveLength,
        Option(
            "The thinnest wall and narrowest channel that the printer makes.",
            _PRINTER,
            label="Smallest feature",
        ),
    ] = Length("0.4", "mm")
    bed: Annotated[
        _TwoLengths,
        Option(
            "WIDTHxDEPTH of the printer's bed, such as 120x68mm.",
            default="120x68mm",
            label="Bed of the printer",
        ),
    ] = (Length("120", "mm"), Length("68", "mm"))
    printer_shrinkage: Annotated[
        _Shrinkage,
        Option(
            "Fraction of its lengths that a print loses; the frame's files are larger by it.",
            _PRINTER,
            label="Shrinkage of the print",
        ),
    ] = Percentage("0", "%")
    crown: Annotated[
        _NotNegativeLength,
        Option(
            "How high the poured resin's middle stands above the frame, so that the mould meets "
            "it first.",
            _AMOUNTS,
            label="Height of the resin's crown",
        ),
    ] = Length("0.1", "mm")
    contact_angle: Annotated[
        Angle,
        Between("0.1 deg", "90 deg"),
        Option(
            "At which the resin runs over the wall's top.",
            _AMOUNTS,
            label="Contact angle of the resin",
        ),
    ] = Angle("30", "deg")
    dish: Annotated[
        _TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the dish that the mould is cast in.",
            _AMOUNTS,
            default="10mm more than the frame on every side",
            label="Dish of the mould",
        ),
    ] = None
    mould_thickness: Annotated[
        PositiveLength, Option("Of the mould.", _AMOUNTS, label="Thickness of the mould")
    ] = Length("5", "mm")
    surface: Annotated[
        SurfaceName,
        Option(
            "What the mask's files show: the master that the mould is taken from, the mould "
            "(mirrored and inverted), or the replica on the camera.",
            label="Surface of the mask's files",
        ),
    ] = "master"
    mould_shrinkage: Annotated[
        _Shrinkage,
        Option(
            "Fraction of its lengths that the mould loses; the master is larger by it.",
            _MASK,
            label="Shrinkage of the mould",
        ),
    ] = Percentage("0", "%")
    crop: Annotated[
        _TwoLengths | None,
        Option(
            "WIDTHxHEIGHT of the middle part of the mask that is written, such as 1x1mm.",
            _MASK,
            default="all of it",
            label="Part of the mask",
        ),
    ] = None
    pitch: Annotated[
        PositiveLength | None,
        Option(
            "Distance of the points in mask.tif, .gds and .oas.",
            _MASK,
            default="the relief's",
            label="Distance of the points",
        ),
    ] = None
    levels: Annotated[
        int,
        Between(2, MOST_LEVELS),
        Option(
            "Heights of the layout, each a layer: layer k is all that is k steps high or higher.",
            _MASK,
            label="Levels",
        ),
    ] = 16
    triangles: Annotated[
        int,
        Between(1, 100_000_000),
        Option("The most that relief-SURFACE.stl has.", _MASK, label="Triangles, at most"),
    ] = 500_000
    base: Annotated[
        PositiveLength,
        Option(
            "Thickness under the lowest point of the relief in the STL.",
            _MASK,
            label="Base under the relief",
        ),
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
    def written(self) -> tuple[Written, ...]:
        """All files in the folder."""
        step = {"frame (STEP)": "frame.step"} if self.step else {}
        return self.in_folder(
            {
                "frame (STL)": "frame.stl",
                "frame (3MF)": "frame.3mf",
                **step,
                "heights": "mask.tif",
                "layout (GDSII)": "mask.gds",
                "layout (OASIS)": "mask.oas",
                "relief (STL)": self.relief_file,
                "process sheet (HTML)": "sheet.html",
                "process sheet (PDF)": "sheet.pdf",
            }
        )

    def package_for(self, camera: Camera) -> Package | None:
        """The package as the options or else the camera give it."""
        if self.package is None or self.glass_top is None:
            return camera.sensor.package
        width, height = self.package
        return Package(
            source="given with --package", width=width, height=height, glass_top=self.glass_top
        )


@job
def fabricate(run: Run[FabricateOptions]) -> Product[Workpieces]:
    """Read a camera and write all files that it is made from; all of them or none.

    Raises
    ------
    NolensError
        If the camera, an option or an output cannot be used.
    """
    options, reporter = run.options, run.reporter
    loaded = run.camera(options.camera)
    camera, package = loaded.camera, options.package_for(loaded.camera)
    if options.step:
        check_step()
    frame, resin, mould = _measures(options, camera)
    budget = None if options.tolerances is None else study_budget(options.tolerances, camera)
    if isinstance(camera.mask.relief, Flat):
        raise OptionError(
            f"the mask of {camera.name!r} is flat: there is nothing to write as a mask. Give a "
            "camera with a relief (nolens design mask makes one)"
        )
    needed = BYTES_OF_PROGRAM + relief_points(loaded) * _BYTES_PER_POINT
    run.begin(needed, "a coarser grid of the camera's relief, or a smaller overhang, needs less")
    reporter.advance("mask", 0.0)
    twin = Twin.of(loaded)
    relief = twin.mask.relief
    surface = made_surface(
        relief,
        options.surface,
        camera.name,
        crop_mm=_both_mm(options.crop),
        mould_shrinkage=options.mould_shrinkage.value,
    )
    mask = surface if options.pitch is None else surface.coarser(options.pitch.um)
    check_height_map(mask)
    pieces = Workpieces.of(
        camera,
        frame,
        resin,
        mould,
        surface,
        mask,
        levels=options.levels,
        triangles=options.triangles,
        base_mm=options.base.mm,
        printer_shrinkage=options.printer_shrinkage.value,
    )
    reporter.advance("process sheet", 0.0)
    sheet = process_sheet(loaded, frame, resin, mould, budget, relief_file=options.relief_file)
    if pieces.size_note is not None:
        reporter.note(pieces.size_note)
    progress = partial(reporter.advance, "layout")
    writers: dict[str, Writer] = {
        **workpiece_writers(pieces, options.relief_file, step=options.step, progress=progress),
        "sheet.html": partial(write_sheet_html, sheet=sheet),
        "sheet.pdf": partial(write_sheet_pdf, sheet=sheet),
    }
    run.warn(*pieces.warnings(camera, package, relief, quarter_um(twin)))
    return Product(
        pieces,
        {"camera": camera.name, **pieces.figures(camera, relief)},
        {
            options.output / name: partial(_announced, write, number / len(writers), reporter)
            for number, (name, write) in enumerate(writers.items())
        },
        {"camera_description": camera.model_dump(mode="json")},
    )


def _announced(write: Writer, fraction: float, reporter: Reporter, path: Path) -> None:
    """Report the fraction of the files that are written, and write the next one."""
    reporter.advance("files", fraction)
    write(path)


def _both_mm(lengths: tuple[Length, Length] | None) -> tuple[float, float] | None:
    return None if lengths is None else (lengths[0].mm, lengths[1].mm)


def _mm(length: Length | None) -> float | None:
    return None if length is None else length.mm


def _measures(
    options: FabricateOptions, camera: Camera
) -> tuple[FrameGeometry, ResinAmount, MouldAmount]:
    frame = FrameGeometry.of(
        camera,
        package=options.package_for(camera),
        wall_mm=options.wall.mm,
        clearance_mm=options.clearance.mm,
        rim_mm=_mm(options.rim),
        vent_width_mm=options.vent_width.mm,
        vent_depth_mm=_mm(options.vent_depth),
        vents=options.vents,
        mark_mm=_mm(options.mark),
        printer=Printer(options.smallest.mm, (options.bed[0].mm, options.bed[1].mm)),
    )
    wetting = Wetting(contact_angle_deg=options.contact_angle.deg)
    resin = ResinAmount.of(camera, frame, crown_mm=options.crown.mm, wetting=wetting)
    thickness_mm = options.mould_thickness.mm
    mould = MouldAmount.of(frame, dish_mm=_both_mm(options.dish), thickness_mm=thickness_mm)
    return frame, resin, mould
