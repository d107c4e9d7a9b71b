"""`nolens camera`."""

import json
from typing import Annotated, Any

from cyclopts import App, Parameter

from nolens.amounts import amount
from nolens.camera import PRESETS, preset_text, to_toml
from nolens.cli.command import Json, command
from nolens.cli.messages import say, show
from nolens.files import read_camera
from nolens.jobs import replace_relief
from nolens.twin import camera_figures

camera = App(name="camera", help="Descriptions of cameras.")

_Described = Annotated[
    Json,
    Parameter(
        help="Print one JSON object on standard output: the description and what follows from it."
    ),
]


@camera.command(name="show")
def show_camera(name: str, /, *, json_: _Described = False) -> int:
    """Print a camera's description, camera.toml, and on standard error what follows from it.

    nolens camera show paper > camera.toml

    Parameters
    ----------
    name
        paper, paper-film, small, live, a folder with camera.toml, or a .toml file.
    """
    loaded = read_camera(name)
    facts = camera_figures(loaded)
    if json_:
        show(json.dumps({"camera": loaded.camera.model_dump(mode="json"), **facts}))
        return 0
    text = preset_text(name) if name in PRESETS else to_toml(loaded.camera)
    for line in text.removesuffix("\n").split("\n"):
        show(line)
    for line in _lines(facts):
        say(line)
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
    if summary["extent_deg"] is not None:
        height, width = summary["extent_deg"]
        lines.append(
            f"light reaches all pixels through it up to {height:g}° along the height and "
            f"{width:g}° along the width"
        )
    return lines


def _lines(facts: dict[str, Any]) -> list[str]:
    height, width = facts["sensor_mm"]
    rows, columns = facts["pixels"]
    shifts = ", ".join(
        f"{angle}° {shift:z.0f} µm" for angle, shift in facts["chief_ray_um"].items()
    )
    lines = [
        f"sensor of {height:.3f} × {width:.3f} mm, {rows}×{columns} pixels of the reconstruction",
        f"the layers are as thick to rays as {facts['reduced_thickness_mm']:.3f} mm of air",
        f"the pattern of a light at 80 mm is {facts['magnification_at_80mm']:.4f} times as large "
        "as that of a far one",
        f"the ray through the middle moves aside by: {shifts}",
        f"pixels saturate at {facts['clip_electrons']:.0f} electrons",
    ]
    if facts["placeholders"]:
        lines.append(f"placeholders, not measured: {', '.join(facts['placeholders'])}")
    return lines


camera.command(command(replace_relief, _relief_lines, name="relief"), name="relief")
