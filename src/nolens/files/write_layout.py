"""Writing levels as a layout: GDSII and OASIS."""

import re
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path

import gdstk

from nolens.fabricate.surface import Levels
from nolens.files.atomic import atomic_write

LEGEND_LAYER = 255
"""Layer of the texts."""
_LONGEST_NAME = 32
_MOST_POINTS = 4000
"""Of a polygon: GDSII allows 8190, and gdstk warns from somewhat fewer on."""
_LONG_AGO = datetime(1980, 1, 1)
"""So that the same levels give the same file."""


def layout(levels: Levels, polygons: Sequence[Sequence[gdstk.Polygon]]) -> gdstk.Library:
    """Lay levels out in one cell, in um and steps of 1 nm.

    Layer 0 is the whole rectangle, layer k level k. Beside the mask, on layer 255, texts say
    which surface it is and how high each layer is.

    Parameters
    ----------
    levels
        The levels.
    polygons
        As `Levels.polygons` gives them.
    """
    surface = levels.surface
    width, height = (side * 1e3 for side in surface.size_mm)
    name = re.sub(r"[^A-Za-z0-9_]", "_", f"{surface.name}_{surface.camera}")[:_LONGEST_NAME]
    library = gdstk.Library(name, unit=1e-6, precision=1e-9)
    cell = library.new_cell(name)
    cell.add(gdstk.rectangle((-width / 2, -height / 2), (width / 2, height / 2), layer=0))
    for level in polygons:
        cell.add(*level)
    lines = [
        f"{surface.words}; camera {surface.camera}; {levels.count} levels of "
        f"{levels.step_um:.6g} um; layer k is all that is k steps high or higher",
        *(
            f"layer {level}: {levels.height_um(level):.6g} um and higher"
            for level in range(levels.count)
        ),
    ]
    spacing = max(height / (levels.count + 1), 1.0)
    for line, text in enumerate(lines):
        place = width / 2 + spacing, height / 2 - line * spacing
        ascii_text = text.encode("ascii", "replace").decode("ascii")
        cell.add(gdstk.Label(ascii_text, place, layer=LEGEND_LAYER, anchor="w"))
    return library


def write_gds(path: str | Path, library: gdstk.Library) -> None:
    """Write a layout as GDSII.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        library.write_gds(str(temporary), max_points=_MOST_POINTS, timestamp=_LONG_AGO)


def write_oasis(path: str | Path, library: gdstk.Library) -> None:
    """Write a layout as OASIS.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        library.write_oas(str(temporary))
