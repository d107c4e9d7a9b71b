"""Height maps as microscopes write them: TIFF, and text with or without a header."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from nolens.documents import parse_json
from nolens.errors import DataError, FileError, OptionError
from nolens.files.check_input import check_content, check_exists
from nolens.files.damage import damage
from nolens.files.quiet import quiet_library
from nolens.files.read_camera import HEIGHTS_IN_UM
from nolens.files.read_tiff import read_tiff_samples
from nolens.files.relief_text import TEXT_SUFFIXES, TextMap, read_text_map
from nolens.files.tiff_note import SOFTWARE
from nolens.quantities import Length

_TIFF_SUFFIXES = (".tif", ".tiff")
_LARGEST = 50_000_000
_SMALLEST = 16
_PITCHES_UM = (0.001, 50.0)
_GIVEN_PITCHES_UM = (0.0001, 1000.0)
_HIGHEST_UM = 1e9
_LARGEST_SPAN_UM = 1e5
_PER_UNIT_UM = {2: 25_400.0, 3: 10_000.0}
_IMAGEJ_UNITS_UM = {
    "nm": 1e-3,
    "um": 1.0,
    "µm": 1.0,
    "\\u00b5m": 1.0,
    "micron": 1.0,
    "microns": 1.0,
    "mm": 1e3,
}


@dataclass(frozen=True)
class HeightMap:
    """Heights that were measured, as they lie in the file.

    Parameters
    ----------
    heights_um
        float64, (rows, columns) in um, NaN where the file marks points as bad.
    pitch_um
        Distance of the rows and of the columns.
    format
        What the file was taken for.
    pitch_from
        Where the pitch comes from.
    """

    heights_um: NDArray[np.float64]
    pitch_um: tuple[float, float]
    format: str
    pitch_from: str


def read_height_map(
    path: str | Path,
    *,
    pitch: Length | None = None,
    unit: str | None = None,
    full_scale: Length | None = None,
) -> HeightMap:
    """Read a map of heights.

    Accepted are TIFF of one channel (whole numbers of 8 to 32 bits, or floats), and text: a table
    of heights with commas, semicolons, tabs or blanks between them, points ``x y z`` on a regular
    grid, the data matrix of Gwyddion with its header, and ISO 25178-71 (.sdf) in ASCII.

    Parameters
    ----------
    path
        The file.
    pitch
        Distance of the points, where the file does not say it or says it wrongly.
    unit
        Length that a value of 1 stands for, such as ``"um"``, where the file does not say it.
    full_scale
        For a TIFF of whole numbers, the height that the largest count stands for.

    Raises
    ------
    FileError
        If the file is missing, damaged, or none of these.
    OptionError
        If the pitch or the unit is needed, or given twice.
    DataError
        If there are fewer than 16 rows or columns, more points than can be worked with, or no
        measured point.
    """
    path = Path(path)
    accepted = f"Accepted are {', '.join((*_TIFF_SUFFIXES, *TEXT_SUFFIXES))}"
    check_exists(path, accepted)
    suffix = path.suffix.lower()
    if suffix not in (*_TIFF_SUFFIXES, *TEXT_SUFFIXES):
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {accepted}")
    if unit is not None and full_scale is not None:
        raise OptionError(
            f"--unit {unit} and --full-scale {full_scale} both say what a value stands for: leave "
            "one out"
        )
    if suffix in _TIFF_SUFFIXES:
        check_content(path, ("TIFF",), accepted)
        found = _from_tiff(path, pitch, unit, full_scale)
    else:
        if full_scale is not None:
            raise OptionError(
                f"--full-scale {full_scale} is for a TIFF of whole numbers: give --unit for "
                f"{path.name}"
            )
        found = _from_text(path, read_text_map(path), pitch, unit)
    _check_heights(path, found.heights_um)
    return found


def _from_tiff(
    path: Path, pitch: Length | None, unit: str | None, full_scale: Length | None
) -> HeightMap:
    values = read_tiff_samples(path).values
    if len(values) != 1:
        raise FileError(
            f"{path} has {len(values)} channels: a map of heights has one. Save the heights, not "
            "the coloured picture of them"
        )
    stored = values.dtype
    if stored.kind not in "uif":
        raise FileError(f"{path} holds {stored.name}: give whole numbers or floats")
    _check_points(path, values.shape[1:])
    try:
        with quiet_library("tifffile"), tifffile.TiffFile(path) as tiff:
            page = tiff.pages.first
            note = _note(page)
            said_um = _tagged_pitch_um(tiff, page)
    # Damaged tags can raise nearly anything.
    except Exception as error:
        raise damage(path, "a TIFF", error) from error
    if full_scale is not None and stored.kind == "f":
        raise OptionError(
            f"--full-scale {full_scale} is for whole numbers, and {path.name} holds {stored.name}: "
            "give --unit"
        )
    zero_um = 0.0
    if note is not None and unit is None and full_scale is None:
        scale_um, zero_um = note
    elif full_scale is not None:
        scale_um = full_scale.um / (2.0 ** (8 * stored.itemsize - (stored.kind == "i")) - 1)
    elif unit is not None:
        scale_um = Length("1", unit).um
    else:
        more = " or --full-scale 20um" if stored.kind != "f" else ""
        raise OptionError(
            f"{path.name} does not say what its heights stand for: give --unit um (or nm, mm){more}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        heights = values[0].astype(np.float64) * scale_um + zero_um
    heights[~np.isfinite(heights)] = np.nan
    steps, whence = _pitch(path, pitch, said_um)
    return HeightMap(heights, steps, f"TIFF of {stored.name}", whence)


def _from_text(path: Path, found: TextMap, pitch: Length | None, unit: str | None) -> HeightMap:
    if found.unit is not None:
        if unit not in (None, found.unit):
            raise OptionError(
                f"{path.name} says its heights are in {found.unit}: leave out --unit {unit}"
            )
        unit = found.unit
    _check_points(path, found.values.shape)
    if unit is None:
        raise OptionError(
            f"{path.name} does not say what its numbers stand for: give --unit um (or nm, mm, m)"
        )
    unit_um = Length("1", unit).um
    said_um = found.pitch_um
    if found.pitch is not None:
        said_um = (found.pitch[0] * unit_um, found.pitch[1] * unit_um)
    steps, whence = _pitch(path, pitch, said_um)
    with np.errstate(over="ignore"):
        return HeightMap(found.values * unit_um, steps, found.format, whence)


def _pitch(
    path: Path, given: Length | None, said_um: tuple[float, float] | None
) -> tuple[tuple[float, float], str]:
    if given is not None:
        if not _GIVEN_PITCHES_UM[0] <= given.um <= _GIVEN_PITCHES_UM[1]:
            raise OptionError(f"--pitch {given}: give 0.1nm to 1mm from one point to the next")
        return (given.um, given.um), "--pitch"
    if said_um is None:
        raise OptionError(
            f"{path.name} does not say how far apart its points lie: give --pitch, such as "
            "--pitch 0.5um"
        )
    if not all(_PITCHES_UM[0] <= each <= _PITCHES_UM[1] for each in said_um):
        raise OptionError(
            f"{path.name} says that its points lie {max(said_um):.4g} µm apart, which is no "
            "microscope's pitch: give the right one, such as --pitch 0.5um"
        )
    return said_um, "the file"


def _note(page: tifffile.TiffPage) -> tuple[float, float] | None:
    """What a value of 1 and one of 0 stand for in um, in the TIFFs of this program."""
    if page.software != SOFTWARE:
        return None
    if page.description == HEIGHTS_IN_UM:
        return 1.0, 0.0
    try:
        note = parse_json(page.description, "the note")
        return float(note["um_per_count"]), float(note["um_at_zero"])
    except (DataError, ValueError, LookupError, TypeError):
        return None


def _tagged_pitch_um(
    tiff: tifffile.TiffFile, page: tifffile.TiffPage
) -> tuple[float, float] | None:
    """Distance of rows and columns by the tags for resolution, None where they do not say it."""
    resolution = [page.tags.get(name) for name in ("YResolution", "XResolution")]
    unit_tag = page.tags.get("ResolutionUnit")
    unit_um = _PER_UNIT_UM.get(int(unit_tag.value)) if unit_tag is not None else None
    if tiff.is_imagej:
        unit_um = _IMAGEJ_UNITS_UM.get(str((tiff.imagej_metadata or {}).get("unit")).lower())
    if unit_um is None or None in resolution:
        return None
    steps = []
    for tag in resolution:
        number, divisor = tag.value  # type: ignore[union-attr]
        if not (number and divisor):
            return None
        steps.append(unit_um * divisor / number)
    return steps[0], steps[1]


def _check_points(path: Path, shape: tuple[int, ...]) -> None:
    rows, columns = shape
    if min(rows, columns) < _SMALLEST:
        raise DataError(
            f"{path} has {rows}×{columns} points: a map of at least {_SMALLEST}×{_SMALLEST} is "
            "needed"
        )
    if rows * columns > _LARGEST:
        factor = math.ceil(math.sqrt(rows * columns / _LARGEST))
        raise DataError(
            f"{path} has {rows}×{columns} points, more than {_LARGEST // 10**6} million: average "
            f"{factor}×{factor} of them to one in the microscope's software, or cut out a part"
        )


def _check_heights(path: Path, heights: NDArray[np.float64]) -> None:
    if bool(np.isnan(heights).all()):
        raise DataError(f"{path} holds no measured point: all of them are marked as bad")
    low, high = float(np.nanmin(heights)), float(np.nanmax(heights))
    if not max(-low, high) <= _HIGHEST_UM or high - low > _LARGEST_SPAN_UM:
        raise DataError(
            f"the heights of {path} go from {low:.3g} to {high:.3g} µm, which no mask's do: check "
            "what a value stands for (--unit, --full-scale)"
        )
