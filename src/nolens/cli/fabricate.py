"""`nolens fabricate`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from nolens.amounts import amount
from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import show
from nolens.cli.terminal import TerminalReporter
from nolens.jobs import FabricateOptions
from nolens.jobs import fabricate as run_fabricate

Frame = Parameter(group="Frame")
Printer = Parameter(group="Printer")
Amounts = Parameter(group="Resin and mould")
Mask = Parameter(group="Mask")
Sheet = Parameter(group="Process sheet")


def fabricate(
    camera: str,
    /,
    *,
    output: Annotated[Path | None, Output] = None,
    package: Annotated[str | None, Quantity, Frame] = None,
    glass_top: Annotated[str | None, Quantity, Frame] = None,
    wall: Annotated[str | None, Quantity, Frame] = None,
    clearance: Annotated[str | None, Quantity, Frame] = None,
    rim: Annotated[str | None, Quantity, Frame] = None,
    vents: Annotated[int | None, Frame, Whole] = None,
    vent_width: Annotated[str | None, Quantity, Frame] = None,
    vent_depth: Annotated[str | None, Quantity, Frame] = None,
    mark: Annotated[str | None, Quantity, Frame] = None,
    step: Annotated[bool | None, Frame] = None,
    smallest: Annotated[str | None, Quantity, Printer] = None,
    bed: Annotated[str | None, Quantity, Printer] = None,
    printer_shrinkage: Annotated[str | None, Quantity, Printer] = None,
    crown: Annotated[str | None, Quantity, Amounts] = None,
    contact_angle: Annotated[str | None, Quantity, Amounts] = None,
    dish: Annotated[str | None, Quantity, Amounts] = None,
    mould_thickness: Annotated[str | None, Quantity, Amounts] = None,
    surface: Annotated[Literal["master", "mould", "replica"] | None, Mask] = None,
    mould_shrinkage: Annotated[str | None, Quantity, Mask] = None,
    crop: Annotated[str | None, Quantity, Mask] = None,
    pitch: Annotated[str | None, Quantity, Mask] = None,
    levels: Annotated[int | None, Mask, Whole] = None,
    triangles: Annotated[int | None, Mask, Whole] = None,
    base: Annotated[str | None, Quantity, Mask] = None,
    tolerances: Annotated[Path | None, Sheet] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Write the files that a camera is made from: frame, mask, process sheet.

    nolens fabricate paper -o workshop

    Lengths, angles and shares are given with their unit: 1.06mm, 30deg, 0.5%.

    Parameters
    ----------
    camera
        paper, small, a folder with camera.toml, or a .toml file; its mask is resin poured onto
        the cover glass.
    output
        Folder of the files, made where it is missing: frame.stl and frame.3mf, mask.tif (16-bit
        heights), mask.gds and mask.oas (levels), relief-SURFACE.stl, sheet.html and sheet.pdf for
        the bench, and fabricate.json, the record with all figures. Needed.
    package
        WIDTHxHEIGHT of the sensor's package, along its rows and across.
        [default: the camera's sensor.package]
    glass_top
        From the board up to the top of the package; with --package.
    wall
        Thickness of the frame's wall.  [default: 1mm]
    clearance
        Between the package and the frame, on every side.  [default: 0.1mm]
    rim
        Legs of the 45° cut along the inside top edge, which takes up resin; 0mm for none.
        [default: 0.3 of the wall]
    vents
        Channels across the wall's top, through which air and resin leave.  [default: 4]
    vent_width
        Of a channel.  [default: 0.8mm]
    vent_depth
        Of a channel.  [default: 0.25mm, or a quarter of a thinner resin]
    mark
        Legs of the outer corner that is cut off at pixel (0, 0); 0mm for none.
        [default: 0.8 of the wall]
    step
        Writes frame.step too; needs nolens[step].  [default: off]
    smallest
        The thinnest wall and narrowest channel that the printer makes.  [default: 0.4mm]
    bed
        WIDTHxDEPTH of the printer's bed.  [default: 120x68mm]
    printer_shrinkage
        Share of its lengths that a print loses; the frame's files are larger by it.
        [default: 0%]
    crown
        How high the poured resin's middle stands above the frame, so that the mould meets it
        first.  [default: 0.1mm]
    contact_angle
        At which the resin runs over the wall's top.  [default: 30deg]
    dish
        WIDTHxHEIGHT of the dish that the mould is cast in.
        [default: 10mm more than the frame on every side]
    mould_thickness
        Of the mould.  [default: 5mm]
    surface
        What the mask's files show: the master that the mould is taken from, the mould (mirrored
        and inverted), or the replica on the camera.  [default: master]
    mould_shrinkage
        Share of its lengths that the mould loses; the master is larger by it.  [default: 0%]
    crop
        WIDTHxHEIGHT of the middle part of the mask that is written, such as 1x1mm.
        [default: all of it]
    pitch
        Distance of the points in mask.tif, .gds and .oas.  [default: the relief's]
    levels
        Heights of the layout, each a layer: layer k is all that is k steps high or higher.
        [default: 16]
    triangles
        The most that relief-SURFACE.stl has.  [default: 500000]
    base
        Thickness under the lowest point of the relief in the STL.  [default: 1mm]
    tolerances
        Folder that nolens design tolerance wrote for this camera, for the budget of the process
        sheet.  [default: a budget from rays]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = run_fabricate(FabricateOptions.gather(given), reporter)
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _lines(summary):
        show(line)
    for path in summary["outputs"]:
        show(path)
    return 0


def _lines(summary: dict[str, Any]) -> list[str]:
    frame, resin, mould = summary["frame"], summary["resin"], summary["mould"]
    mask, relief = summary["mask"], summary["relief"]
    width, height, tall = frame["outer_mm"]
    angle = frame["shading_angle_deg"]
    shades = "shades no pixel" if angle is None else f"shades pixels from {angle:.0f}° on"
    mass = "" if resin["mass_mg"] is None else f", {resin['mass_mg']:.0f} mg"
    low, high = mask["heights_um"]
    rows, columns = mask["points"]
    return [
        f"frame {width:.2f} × {height:.2f} × {tall:.2f} mm around {frame['inner_mm'][0]:.2f} × "
        f"{frame['inner_mm'][1]:.2f} mm, {frame['volume_mm3']:.1f} mm³; it {shades}",
        f"pour {resin['pour_mm3']:.1f} mm³{mass} of {resin['material'] or 'the resin'}: cavity "
        f"{resin['cavity_mm3']:.1f} mm³, shrinkage {100 * resin['shrinkage']:g} %, rim and vents "
        f"{resin['overflow_mm3']:.1f} mm³, crown {resin['meniscus_mm3']:.1f} mm³",
        f"mould {mould['dish_mm'][0]:.1f} × {mould['dish_mm'][1]:.1f} × {mould['thickness_mm']:g} "
        f"mm: {mould['base_g']:.2f} g base, {mould['hardener_g']:.2f} g hardener "
        f"({mould['ratio']:g}:1)",
        f"mask {mask['about']}: {mask['size_mm'][0]:.3f} × {mask['size_mm'][1]:.3f} mm, "
        f"{rows}×{columns} points, {low:.3f} to {high:.3f} µm, {mask['levels']} levels of "
        f"{1e3 * mask['step_um']:.1f} nm",
        f"relief of {relief['triangles']} triangles, a point every "
        f"{amount(relief['pitch_um'], 'um')}: "
        f"{amount(1e3 * relief['rms_error_um'], 'nm', digits=2)} rms beside the mask's heights",
        f"{summary['seconds']:.1f} s",
    ]
