"""Writing solids: STL and 3MF."""

import zipfile
from pathlib import Path
from xml.sax.saxutils import escape

import numpy as np

from nolens.fabricate.solid import Solid
from nolens.files.atomic import atomic_write

_HEADER = 80
_LONG_AGO = (1980, 1, 1, 0, 0, 0)
"""So that the same solid gives the same file."""
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


def write_stl(path: str | Path, solid: Solid) -> None:
    """Write a solid as binary STL in mm; the header of 80 bytes holds as much of its title.

    Parameters
    ----------
    path
        The file to write.
    solid
        The solid.

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

    Parameters
    ----------
    path
        The file to write.
    solid
        The solid.

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
