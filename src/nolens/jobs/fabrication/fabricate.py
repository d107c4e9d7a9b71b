"""A camera's files for the workshop: frame, mask, amounts, process sheet."""

import math
from functools import partial
from pathlib import Path

import torch

from nolens.amounts import amount
from nolens.camera import Flat, OpenCamera
from nolens.design.masks import quarter_um
from nolens.errors import OptionError
from nolens.fabricate import (
    MOST_LEVELS,
    FrameGeometry,
    Levels,
    MouldAmount,
    Printer,
    ResinAmount,
    Wetting,
    decimated,
    frame_solid,
    made_surface,
    process_sheet,
    relief_solid,
    shading_angle_deg,
)
from nolens.files import (
    camera_files,
    check_height_map,
    check_step,
    layout,
    read_camera,
    write_3mf,
    write_gds,
    write_height_map,
    write_oasis,
    write_step,
    write_stl,
)
from nolens.files.write_sheet import write_sheet_html, write_sheet_pdf
from nolens.jobs.designing.tolerance import study_budget
from nolens.jobs.fabrication.figures import Workpieces, figures
from nolens.jobs.fabrication.options import FabricateOptions
from nolens.jobs.run import BYTES_OF_PROGRAM, Product, Reporter, Run, Writer, check_memory, job
from nolens.optics import Relief
from nolens.twin import Twin, relief_points

_BYTES_PER_POINT = 30.0
_LARGE_BYTES = 20e6
_CPU = torch.device("cpu")


@job
def fabricate(run: Run[FabricateOptions]) -> Product[Workpieces]:
    """Read a camera and write all files that it is made from; all of them or none.

    Raises
    ------
    NolensError
        If the camera, an option or an output cannot be used.
    """
    options, reporter = run.options, run.reporter
    opened = read_camera(options.camera)
    run.reads(camera_files(options.camera, opened.camera))
    if options.step:
        check_step()
    frame, resin, mould = _measures(options, opened)
    budget = None if options.tolerances is None else study_budget(options.tolerances, opened.camera)
    run.begin(_needed(opened))
    reporter.advance("mask", 0.0)
    twin = Twin.of(opened)
    relief = twin.mask.relief
    pieces = _pieces(options, opened, relief, (frame, resin, mould))
    reporter.advance("process sheet", 0.0)
    sheet = process_sheet(opened, frame, resin, mould, budget, relief_file=options.relief_file)
    _tell_sizes(pieces, reporter)
    library = layout(pieces.levels, pieces.levels.polygons(partial(reporter.advance, "layout")))
    run.warn(
        *_warnings(options, opened, resin),
        *_fit_warnings(frame, opened, relief),
        *_level_warnings(pieces.levels, quarter_um(twin)),
    )
    writers: dict[str, Writer] = {
        "frame.stl": partial(write_stl, solid=pieces.solid),
        "frame.3mf": partial(write_3mf, solid=pieces.solid),
        "mask.tif": partial(write_height_map, surface=pieces.mask),
        "mask.gds": partial(write_gds, library=library),
        "mask.oas": partial(write_oasis, library=library),
        options.relief_file: partial(write_stl, solid=pieces.relief),
        "sheet.html": partial(write_sheet_html, sheet=sheet),
        "sheet.pdf": partial(write_sheet_pdf, sheet=sheet),
    }
    if options.step:
        writers["frame.step"] = partial(
            write_step,
            frame=frame,
            title=pieces.solid.title,
            shrinkage=options.printer_shrinkage.value,
        )
    return Product(
        pieces,
        {"camera": opened.camera.name, **figures(options, opened, pieces, relief)},
        {
            options.output / name: partial(_told, write, number / len(writers), reporter)
            for number, (name, write) in enumerate(writers.items())
        },
        {"camera_description": opened.camera.model_dump(mode="json")},
    )


def _told(write: Writer, share: float, reporter: Reporter, path: Path) -> None:
    """Write a file, once the share of files that are written has been told."""
    reporter.advance("files", share)
    write(path)


def _measures(
    options: FabricateOptions, opened: OpenCamera
) -> tuple[FrameGeometry, ResinAmount, MouldAmount]:
    camera = opened.camera
    frame = FrameGeometry.of(
        camera,
        package=options.package_for(camera),
        wall_mm=options.wall.mm,
        clearance_mm=options.clearance.mm,
        rim_mm=None if options.rim is None else options.rim.mm,
        vent_width_mm=options.vent_width.mm,
        vent_depth_mm=None if options.vent_depth is None else options.vent_depth.mm,
        vents=options.vents,
        mark_mm=None if options.mark is None else options.mark.mm,
        printer=Printer(options.smallest.mm, (options.bed[0].mm, options.bed[1].mm)),
    )
    wetting = Wetting(contact_angle_deg=options.contact_angle.deg)
    resin = ResinAmount.of(camera, frame, crown_mm=options.crown.mm, wetting=wetting)
    dish = None if options.dish is None else (options.dish[0].mm, options.dish[1].mm)
    mould = MouldAmount.of(frame, dish_mm=dish, thickness_mm=options.mould_thickness.mm)
    return frame, resin, mould


def _needed(opened: OpenCamera) -> float:
    """Bytes that the relief takes, where there is one that this machine can hold."""
    if isinstance(opened.camera.mask.relief, Flat):
        raise OptionError(
            f"the mask of {opened.camera.name!r} is flat: there is nothing to write as a mask. "
            "Give a camera with a relief (nolens design mask makes one)"
        )
    needed = BYTES_OF_PROGRAM + relief_points(opened) * _BYTES_PER_POINT
    check_memory(needed, _CPU, "a coarser grid of the camera's relief, or a smaller overhang")
    return needed


def _pieces(
    options: FabricateOptions,
    opened: OpenCamera,
    relief: Relief,
    measures: tuple[FrameGeometry, ResinAmount, MouldAmount],
) -> Workpieces:
    name, frame = opened.camera.name, measures[0]
    whole = made_surface(
        relief,
        options.surface,
        name,
        crop_mm=None if options.crop is None else (options.crop[0].mm, options.crop[1].mm),
        mould_shrinkage=options.mould_shrinkage.value,
    )
    mask = whole if options.pitch is None else whole.coarser(options.pitch.um)
    check_height_map(mask)
    levels = Levels(mask, options.levels)
    levels.check_size()
    thinned = decimated(whole, options.triangles)
    solid = frame_solid(frame, f"frame of {name}, in mm; cut corner at pixel (0, 0)")
    pieces = Workpieces(
        *measures,
        solid.grown(options.printer_shrinkage.value),
        mask,
        levels,
        thinned,
        relief_solid(thinned, options.base.mm),
    )
    for each in (pieces.solid, pieces.relief):
        each.check_closed()
    return pieces


def _tell_sizes(pieces: Workpieces, reporter: Reporter) -> None:
    levels = pieces.levels
    sizes = {
        "mask.tif": 2.0 * pieces.mask.height_um.numel(),
        "mask.gds": levels.expected_bytes("GDS"),
        "mask.oas": levels.expected_bytes("OASIS"),
    }
    if sum(sizes.values()) > _LARGE_BYTES:
        large = ", ".join(f"{name} {size / 1e6:.0f} MB" for name, size in sizes.items())
        reporter.note(
            f"files will have about: {large}. A coarser --pitch, a --crop or fewer --levels make "
            "them smaller"
        )


def _warnings(options: FabricateOptions, opened: OpenCamera, resin: ResinAmount) -> list[str]:
    camera = opened.camera
    package = options.package_for(camera)
    warnings = list(resin.notes)
    if package is not None and package.source.startswith("placeholder"):
        warnings.append(
            f"the package's size is no measurement ({package.source}): measure the sensor before "
            "printing"
        )
    if camera.mask.aperture is not None:
        warnings.append(
            "the camera has an aperture, which these files do not hold: make it of opaque film"
        )
    return warnings


def _level_warnings(levels: Levels, coarsest_um: float) -> list[str]:
    if levels.step_um <= coarsest_um:
        return []
    low, high = levels.surface.range_um
    needed = math.ceil((high - low) / coarsest_um) + 1
    return [
        f"{levels.count} levels lie {amount(levels.step_um, 'um', digits=2)} apart, more than the "
        f"{amount(coarsest_um, 'um', digits=2)} that turn the light by a quarter of a wavelength: "
        f"a mask made of mask.gds or mask.oas scatters light; "
        + (f"--levels {needed} would not" if needed <= MOST_LEVELS else "take mask.tif instead")
    ]


def _fit_warnings(frame: FrameGeometry, opened: OpenCamera, relief: Relief) -> list[str]:
    height, width = (side * 1e-3 for side in relief.extent_um)
    warnings = []
    if width > frame.inner_width_mm or height > frame.inner_height_mm:
        warnings.append(
            f"the relief of {width:.4g} × {height:.4g} mm is larger than the frame's inside of "
            f"{frame.inner_width_mm:.4g} × {frame.inner_height_mm:.4g} mm: on the camera it ends "
            "at the wall"
        )
    angle = shading_angle_deg(opened.camera, frame)
    if angle == 0:
        warnings.append("the wall stands over the sensor's edge and shades it")
    return warnings
