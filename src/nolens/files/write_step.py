"""Writing the frame as STEP, which CAD programs can change."""

import importlib
from pathlib import Path
from typing import Any

from nolens.errors import FileError, OptionError
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.solid import outline, vent_boxes
from nolens.files.atomic import atomic_write


def check_step() -> None:
    """Refuse to write STEP where build123d is not installed.

    Raises
    ------
    OptionError
        If it is not.
    """
    _build123d()


def write_step(path: str | Path, frame: FrameGeometry, title: str, shrinkage: float = 0.0) -> None:
    """Write the frame as STEP in mm: faces and edges, not triangles.

    Parameters
    ----------
    path
        The file to write.
    frame
        Its measures; it stands on z = 0 with its middle at x = y = 0.
    title
        Name of the part.
    shrinkage
        Fraction of all lengths that the printer's material loses: the part is made larger by it.

    Raises
    ------
    OptionError
        If build123d is not installed.
    FileError
        If the file cannot be written.
    """
    cad = _build123d()
    part = _part(cad, frame)
    part = cad.scale(part, by=1 / (1 - shrinkage)) if shrinkage > 0 else part
    part.label = title
    with atomic_write(path) as temporary:
        if not cad.export_step(part, str(temporary)):
            raise FileError(f"cannot write {path}: the STEP writer failed. Give another path")


def _part(cad: Any, frame: FrameGeometry) -> Any:
    height, r = frame.height_mm, frame.rim_mm
    inner = frame.inner_width_mm, frame.inner_height_mm
    floor = cad.Align.CENTER, cad.Align.CENTER, cad.Align.MIN
    part = cad.extrude(cad.make_face(cad.Polyline(*outline(frame), close=True)), height)
    part -= cad.Box(*inner, height, align=floor)
    if r > 0:
        low = cad.Pos(0, 0, height - r) * cad.Rectangle(*inner)
        high = cad.Pos(0, 0, height) * cad.Rectangle(inner[0] + 2 * r, inner[1] + 2 * r)
        part -= cad.loft([low, high])
    for middle, size in vent_boxes(frame):
        at = cad.Pos(*middle, height - frame.vent_depth_mm)
        part -= at * cad.Box(*size, frame.vent_depth_mm, align=floor)
    return part


def _build123d() -> Any:
    try:
        return importlib.import_module("build123d")
    except ImportError:
        raise OptionError(
            "STEP files (--step) need build123d, which is not installed: pip install "
            "'nolens[step]', or take the frame as .stl and .3mf"
        ) from None
