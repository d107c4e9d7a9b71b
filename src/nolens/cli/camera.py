"""`nolens camera`."""

import json
from typing import Annotated, Any

from cyclopts import App

from nolens.camera import PRESETS, camera_to_toml, preset_text
from nolens.cli.app import Json
from nolens.cli.messages import say, show
from nolens.files import read_camera
from nolens.jobs import camera_facts

camera = App(name="camera", help="Descriptions of cameras.")


@camera.command(name="show")
def show_camera(name: str, /, *, json_: Annotated[bool, Json] = False) -> int:
    """Print a camera's description, camera.toml, and on standard error what follows from it.

    nolens camera show paper > camera.toml

    Parameters
    ----------
    name
        paper, paper-film, small, a folder with camera.toml, or a .toml file.
    json_
        Print one JSON object on standard output: the description and what follows from it.
    """
    opened = read_camera(name)
    facts = camera_facts(opened)
    if json_:
        show(json.dumps({"camera": opened.camera.model_dump(mode="json"), **facts}))
        return 0
    text = preset_text(name) if name in PRESETS else camera_to_toml(opened.camera)
    show(text.removesuffix("\n"))
    for line in _lines(facts):
        say(line)
    return 0


def _lines(facts: dict[str, Any]) -> list[str]:
    height, width = facts["sensor_mm"]
    rows, columns = facts["cells"]
    shifts = ", ".join(f"{angle}° {shift:.0f} um" for angle, shift in facts["chief_ray_um"].items())
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
