"""Files for the workshop: solids (STL, 3MF, STEP), levels as a layout, heights as a TIFF."""

import importlib
import re
import zipfile
from collections.abc import Sequence
from datetime import datetime
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import gdstk
import numpy as np

from nolens.errors import FileError, OptionError
from nolens.fabricate.frame import FrameGeometry
from nolens.fabricate.solid import Solid, frame_corners, vent_boxes
from nolens.fabricate.surface import Levels, MadeSurface
from nolens.fabricate.workpieces import Workpieces
from nolens.files.atomic import Writer, atomic_write
from nolens.files.tiff import write_tiff
from nolens.progress import ProgressCallback

_LEGEND_LAYER = 255
"""Layer of a layout's texts."""
_HEADER = 80
_LONG_AGO = (1980, 1, 1, 0, 0, 0)
"""So that the same solid or layout gives the same file."""
_CORE = "http://schemas.microsoft.com/3dmanufacturing/core/2015/02"
_PACKAGE = "http://schemas.openxmlformats.org/package/2006"
_MODEL_TYPE = "application/vnd.ms-package.3dmanufacturing-3dmodel+xml"
_TYPES = (
    f'<Types xmlns="{_PACKAGE}/content-types"><Default Extension="rels" ContentType="application/'
    'vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" ContentType="'
    f'{_MODEL_TYPE}"/></Types>'
)
_RELATIONS = (
    f'<Relationships xmlns="{_PACKAGE}/relationships"><Relationship Id="rel0" Target="/3D/3dmodel'
    '.model" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/></Relationships>'
)

_LONGEST_NAME = 32
_MOST_POINTS = 4000
"""Of a polygon: GDSII allows 8190, and gdstk warns from somewhat fewer on."""

_COUNTS = 65535
_UM_PER_CM = 10_000
_LARGEST_PART = 2**32 - 1
_MOST_BYTES = 4e9
_FLAT_UM = 1e-3
"""Height of a count of a surface without heights."""


def workpiece_writers(
    pieces: Workpieces, relief_file: str, *, step: bool, progress: ProgressCallback
) -> dict[str, Writer]:
    """What writes each file of the workshop but the process sheets, by its name.

    The layout is computed here, and its progress reported. `step` writes ``frame.step`` too.
    """
    library = layout(pieces.levels, pieces.levels.polygons(progress))
    writers: dict[str, Writer] = {
        "frame.stl": partial(write_stl, solid=pieces.solid),
        "frame.3mf": partial(write_3mf, solid=pieces.solid),
        "mask.tif": partial(write_height_map, surface=pieces.mask),
        "mask.gds": partial(write_gds, library=library),
        "mask.oas": partial(write_oasis, library=library),
        relief_file: partial(write_stl, solid=pieces.relief),
    }
    if step:
        writers["frame.step"] = partial(
            write_step,
            frame=pieces.frame,
            title=pieces.solid.title,
            shrinkage=pieces.printer_shrinkage,
        )
    return writers


def write_stl(path: str | Path, solid: Solid) -> None:
    """Write a solid as binary STL in mm; the header of 80 bytes holds as much of its title.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    corners = solid.vertices_mm[solid.triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    records = np.zeros(len(corners), [("vectors", "<f4", (4, 3)), ("attribute", "<u2")])
    records["vectors"][:, 0] = normals / np.where(lengths > 0, lengths, 1)
    records["vectors"][:, 1:] = corners
    header = solid.title.encode("ascii", "replace")[:_HEADER].ljust(_HEADER)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        file.write(header)
        file.write(np.uint32(len(records)).astype("<u4").tobytes())
        records.tofile(file)


def write_3mf(path: str | Path, solid: Solid) -> None:
    """Write a solid as 3MF in mm, with its title as the model's.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    vertices = "".join(
        f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in solid.vertices_mm.tolist()
    )
    triangles = "".join(
        f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in solid.triangles.tolist()
    )
    title = escape(solid.title)
    model = (
        f'<model unit="millimeter" xml:lang="en-GB" xmlns="{_CORE}">'
        f'<metadata name="Title">{title}</metadata>'
        '<metadata name="Application">nolens</metadata>'
        f'<resources><object id="1" type="model"><mesh><vertices>{vertices}</vertices>'
        f"<triangles>{triangles}</triangles></mesh></object></resources>"
        '<build><item objectid="1"/></build></model>'
    )
    parts = {"[Content_Types].xml": _TYPES, "_rels/.rels": _RELATIONS, "3D/3dmodel.model": model}
    with atomic_write(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        for name, text in parts.items():
            entry = zipfile.ZipInfo(name, _LONG_AGO)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, f'<?xml version="1.0" encoding="UTF-8"?>\n{text}')


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
    part = _step_part(cad, frame)
    part = cad.scale(part, by=1 / (1 - shrinkage)) if shrinkage > 0 else part
    part.label = title
    with atomic_write(path) as temporary:
        if not cad.export_step(part, str(temporary)):
            raise FileError(f"cannot write {path}: the STEP writer failed. Give another path")


def _step_part(cad: Any, frame: FrameGeometry) -> Any:
    height, r = frame.height_mm, frame.rim_mm
    inner = frame.inner_width_mm, frame.inner_height_mm
    floor = cad.Align.CENTER, cad.Align.CENTER, cad.Align.MIN
    part = cad.extrude(cad.make_face(cad.Polyline(*frame_corners(frame), close=True)), height)
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


def layout(levels: Levels, polygons: Sequence[Sequence[gdstk.Polygon]]) -> gdstk.Library:
    """Lay the polygons of levels (`Levels.polygons`) out in one cell, in um and steps of 1 nm.

    Layer 0 is the whole rectangle, layer k level k. Beside the mask, on layer 255, texts say
    which surface it is and how high each layer is.
    """
    surface = levels.surface
    width, height = (side * 1e3 for side in surface.size_mm)
    name = re.sub(r"[^A-Za-z0-9_]", "_", f"{surface.name}_{surface.camera}")[:_LONGEST_NAME]
    library = gdstk.Library(name, unit=1e-6, precision=1e-9)
    top = library.new_cell(name)
    top.add(gdstk.rectangle((-width / 2, -height / 2), (width / 2, height / 2), layer=0))
    for level in polygons:
        top.add(*level)
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
        top.add(gdstk.Label(ascii_text, place, layer=_LEGEND_LAYER, anchor="w"))
    return library


def write_gds(path: str | Path, library: gdstk.Library) -> None:
    """Write a layout as GDSII.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        library.write_gds(str(temporary), max_points=_MOST_POINTS, timestamp=datetime(*_LONG_AGO))


def write_oasis(path: str | Path, library: gdstk.Library) -> None:
    """Write a layout as OASIS.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        library.write_oas(str(temporary))


def check_height_map(surface: MadeSurface) -> None:
    """Refuse a surface that a TIFF has no room for.

    Raises
    ------
    OptionError
        If it would have more than 4 GB; says what would fit.
    """
    size = 2 * surface.height_um.numel()
    if size > _MOST_BYTES:
        coarser = surface.pitch_um * (size / _MOST_BYTES) ** 0.5
        raise OptionError(
            f"the heights take {size / 1e9:.1f} GB, and a TIFF holds {_MOST_BYTES / 1e9:g} GB: a "
            f"--pitch of {coarser:.3g}um or more would fit, or a --crop"
        )


def write_height_map(path: str | Path, surface: MadeSurface) -> None:
    """Write heights as 16-bit grey TIFF: ``round(65535 (h − lowest) / (highest − lowest))``.

    The first row of the file is the surface's last one, so that the picture shows what one sees
    who looks onto the surface. Its pitch is the resolution (pixels in a cm); the pitch, the
    height of a count and of zero, and which surface it is stand in the description, as JSON.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    low, high = surface.range_um
    per_count = (high - low) / _COUNTS if high > low else _FLAT_UM
    heights = surface.height_um.flip(0).numpy()
    counts = np.empty(heights.shape, np.uint16)
    for row, line in enumerate(heights):
        counts[row] = np.rint((line.astype(np.float64) - low) / per_count)
    note = {
        "surface": surface.name,
        "about": surface.words,
        "camera": surface.camera,
        "pitch_um": surface.pitch_um,
        "um_per_count": per_count,
        "um_at_zero": low,
        "lowest_um": low,
        "highest_um": high,
        "size_mm": list(surface.size_mm),
        "first_row": "top of the surface, seen from above it",
    }
    resolution = Fraction(_UM_PER_CM / surface.pitch_um).limit_denominator(
        max(1, int(_LARGEST_PART * min(1.0, surface.pitch_um / _UM_PER_CM)))
    )
    pair = resolution.numerator, resolution.denominator
    write_tiff(path, counts, note, resolution=(pair, pair), resolutionunit="CENTIMETER")
