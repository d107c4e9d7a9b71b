"""`nolens camera`."""

import json
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Parameter

from nolens.amounts import amount
from nolens.camera import PRESETS, camera_to_toml, preset_text
from nolens.cli.app import Json, Output, Quantity, Whole, given_options
from nolens.cli.messages import say, show
from nolens.cli.terminal import TerminalReporter
from nolens.files import read_camera
from nolens.jobs import ReliefOptions, camera_facts, replace_relief

camera = App(name="camera", help="Descriptions of cameras.")

File = Parameter(group="What the file holds")
Part = Parameter(group="What was measured")
Result = Parameter(group="Result")


@camera.command(name="show")
def show_camera(name: str, /, *, json_: Annotated[bool, Json] = False) -> int:
    """Print a camera's description, camera.toml, and on standard error what follows from it.

    nolens camera show paper > camera.toml

    Parameters
    ----------
    name
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.
    json_
        Print one JSON object on standard output: the description and what follows from it.
    """
    opened = read_camera(name)
    facts = camera_facts(opened)
    if json_:
        show(json.dumps({"camera": opened.camera.model_dump(mode="json"), **facts}))
        return 0
    text = preset_text(name) if name in PRESETS else camera_to_toml(opened.camera)
    for line in text.removesuffix("\n").split("\n"):
        show(line)
    for line in _lines(facts):
        say(line)
    return 0


@camera.command(name="relief")
def replace_relief_of(
    camera: str,
    map: Path,  # noqa: A002 (the argument's name)
    /,
    *,
    output: Annotated[Path | None, Output, Result] = None,
    pitch: Annotated[str | None, Quantity, File] = None,
    unit: Annotated[Literal["nm", "um", "mm", "m"] | None, File] = None,
    full_scale: Annotated[str | None, Quantity, File] = None,
    mirror: Annotated[bool | None, Part] = None,
    invert: Annotated[bool | None, Part] = None,
    turn: Annotated[int | None, Part, Whole] = None,
    keep_tilt: Annotated[bool | None, Part] = None,
    grid: Annotated[str | None, Quantity, Result] = None,
    tile: Annotated[bool | None, Result] = None,
    json_: Annotated[bool, Json] = False,
) -> int:
    """Put a relief that was measured on a microscope in the place of a camera's own.

    nolens camera relief paper heights.tif --pitch 0.5um --unit um --mirror -o measured

    nolens psf --camera measured -o psf.tif

    Then the twin simulates the part that was really made.

    A camera's relief has the rows and columns of its picture; a microscope shows the mask from
    the scene, as the mirror image of that. For a map of the replica give --mirror, also for one
    of its master, or for the mask.tif of either from nolens fabricate. For one of the mould,
    which is the mirror image of both, give --invert --turn 180 instead, and for the relief.tif
    of a camera neither. This is for a camera that stands upright, and for a mould turned over
    like a page; where the map lies otherwise, --turn it.

    Parameters
    ----------
    camera
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file. All but the
        relief stays.
    map
        Heights: .tif (grey, whole numbers or floats), or text: a table of heights, points x y z
        on a grid (y downwards), Gwyddion's data matrix, or .sdf (ISO 25178-71, ASCII). nan, Bad
        or nothing marks points that were not measured.
    output
        Folder of the new camera: camera.toml, relief.tif, the curves that the camera names, and
        relief.json, the record. Needed.
    pitch
        Distance of the map's points, such as 0.5um.  [default: what the file says]
    unit
        Length that a value of 1 stands for: nm, um, mm or m; for points, x and y too.
        [default: what the file says]
    full_scale
        Height that the largest count of a .tif of whole numbers stands for, such as 20um.
    mirror
        Exchanges top and bottom.  [default: off]
    invert
        Takes heights for depths.  [default: off]
    turn
        Turns the map by 90, 180 or 270 degrees, anticlockwise, after --mirror.  [default: 0]
    keep_tilt
        Leaves the best-fit plane in, which is taken away otherwise.  [default: off]
    grid
        Distance of the points of the camera's relief.
        [default: that of the relief so far, or of the pixels]
    tile
        Continues a map that is too small by reflection at its edges: then only the statistics
        of the pattern are right.  [default: off]
    json_
        Print one JSON object on standard output.
    """
    given = given_options(locals())
    reporter = TerminalReporter()
    with reporter:
        summary = replace_relief(ReliefOptions.gather(given), reporter).summary
    if json_:
        show(json.dumps(summary))
        return 0
    for line in _relief_lines(summary):
        show(line)
    return 0


def _relief_lines(summary: dict[str, Any]) -> list[str]:
    about = summary["map"]
    rows, columns = about["points"]
    down, right = about["pitch_um"]
    pitch = f"{down:g}" if down == right else f"{down:g} × {right:g}"
    tilt = ", ".join(f"{each:.3g}" for each in about["tilt_mrad"])
    lines = [
        f"{about['format']}: {rows}×{columns} points {pitch} µm apart ({about['pitch_from']})",
        f"tilt of {tilt} mrad along height and width "
        + ("taken away" if about["tilt_removed"] else "left in")
        + f"; bow of {amount(about['bow_um'], 'um')} left in",
    ]
    for name in ("measured", "described"):
        figures = summary[name]
        if figures is None:
            lines.append(f"{name}: flat")
            continue
        tops = "no tops"
        if figures["radius_um"] is not None:
            radius = amount(figures["radius_um"], "um", digits=4)
            tops = f"{figures['tops']} tops with a radius of {radius}"
        height, width = (each * 1e-3 for each in figures["size_um"])
        lines.append(
            f"{name}: {amount(height)} × {amount(width, 'mm')}, rms "
            f"{amount(figures['rms_um'], 'um')}, peak to valley "
            f"{amount(figures['peak_to_valley_um'], 'um')}, steepest slope "
            f"{figures['steepest']:.3g}, {tops}"
        )
    if summary["reach_deg"] is not None:
        height, width = summary["reach_deg"]
        lines.append(
            f"light reaches all pixels through it up to {height:g}° along the height and "
            f"{width:g}° along the width"
        )
    return [*lines, *summary["outputs"]]


def _lines(facts: dict[str, Any]) -> list[str]:
    height, width = facts["sensor_mm"]
    rows, columns = facts["cells"]
    shifts = ", ".join(
        f"{angle}° {shift:z.0f} µm" for angle, shift in facts["chief_ray_um"].items()
    )
    lines = [
        f"sensor of {height:.3f} × {width:.3f} mm, {rows}×{columns} cells of the reconstruction",
        f"the layers are as thick to rays as {facts['reduced_thickness_mm']:.3f} mm of air",
        f"the pattern of a light at 80 mm is {facts['magnification_at_80mm']:.4f} times as large "
        "as that of a far one",
        f"the ray through the middle moves aside by: {shifts}",
        f"pixels saturate at {facts['clip_electrons']:.0f} electrons",
    ]
    if facts["placeholders"]:
        lines.append(f"placeholders, not measured: {', '.join(facts['placeholders'])}")
    return lines
