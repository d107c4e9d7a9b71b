"""Writing the heights of a surface for grey-scale and two-photon lithography."""

import json
from fractions import Fraction
from pathlib import Path

import numpy as np
import tifffile

from nolens.errors import OptionError
from nolens.fabricate.surface import MadeSurface
from nolens.files.atomic import atomic_write
from nolens.files.tiff import SOFTWARE

_COUNTS = 65535
_UM_PER_CM = 10_000
_LARGEST = 2**32 - 1
_MOST_BYTES = 4e9
_FLAT_UM = 1e-3
"""Height of a count of a surface without heights."""


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

    Parameters
    ----------
    path
        The file to write.
    surface
        The surface.

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
        max(1, int(_LARGEST * min(1.0, surface.pitch_um / _UM_PER_CM)))
    )
    pair = resolution.numerator, resolution.denominator
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            counts,
            photometric="minisblack",
            resolution=(pair, pair),
            resolutionunit="CENTIMETER",
            description=json.dumps(note),
            metadata=None,
            software=SOFTWARE,
        )
