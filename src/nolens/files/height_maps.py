"""Height maps as microscopes write them: TIFF, and text with or without a header."""

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from numpy.typing import NDArray

from nolens.errors import DataError, FileError, OptionError
from nolens.files.input import check_bytes, check_content, check_exists, decoding, system_errors
from nolens.files.tiff import HEIGHTS_IN_UM, SOFTWARE, open_tiff, own_note, read_tiff_samples
from nolens.quantities import Length

_TIFF_SUFFIXES = (".tif", ".tiff")
_LARGEST = 50_000_000
_SMALLEST = 16
_PITCHES_UM = (0.001, 50.0)
_OPTION_PITCHES_UM = (0.0001, 1000.0)
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
_TEXT_SUFFIXES = (".txt", ".csv", ".tsv", ".asc", ".xyz", ".dat", ".sdf")
_BAD = frozenset({"", "bad", "nan", "n/a", "na", "null", "none", "---", "inf", "-inf"})
_SDF = re.compile(r"^\s*[aA](ISO|BCR)-1\.0\s*$")
_BINARY_SDF = (b"bISO-1.0", b"bBCR-1.0")
_COST = 10
"""Bytes of memory for one of a text, most of them for the numbers as texts of their own."""
_LONGEST_VALUE = 1000
_SPACING = 1e-3
"""Fraction of the pitch by which points may lie beside their grid."""


@dataclass(frozen=True)
class HeightMap:
    """Measured heights, (rows, columns) in um, NaN where the file marks points as bad.

    The pitch is the distance of the rows and of the columns, with where it comes from; `format` is
    what the file was taken for.
    """

    heights_um: NDArray[np.float64]
    pitch_um: tuple[float, float]
    format: str
    pitch_from: str


@dataclass(frozen=True)
class _TextMap:
    """Numbers of a text, NaN where it marks points as bad, and what it says of them.

    `unit` is that of the values; the distance of rows and columns is `pitch_um`, or `pitch` in the
    unit of the values; None where the text does not say it.
    """

    values: NDArray[np.float64]
    format: str
    unit: str | None = None
    pitch_um: tuple[float, float] | None = None
    pitch: tuple[float, float] | None = None


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
    accepted = f"Accepted are {', '.join((*_TIFF_SUFFIXES, *_TEXT_SUFFIXES))}"
    check_exists(path, accepted)
    suffix = path.suffix.lower()
    if suffix not in (*_TIFF_SUFFIXES, *_TEXT_SUFFIXES):
        raise FileError(f"{path}: the suffix {suffix or '(none)'} is not known. {accepted}")
    if unit is not None and full_scale is not None:
        raise OptionError(
            f"--unit {unit} and --full-scale {full_scale} both say what a value stands for: leave "
            "one out"
        )
    if suffix in _TIFF_SUFFIXES:
        check_content(path, ("TIFF",), accepted)
        heights = _from_tiff(path, pitch, unit, full_scale)
    else:
        if full_scale is not None:
            raise OptionError(
                f"--full-scale {full_scale} is for a TIFF of whole numbers: give --unit for "
                f"{path.name}"
            )
        heights = _from_text(path, _read_text_map(path), pitch, unit)
    _check_heights(path, heights.heights_um)
    return heights


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
    with decoding(path, "a TIFF"), open_tiff(path) as tiff:
        page = tiff.pages.first
        note = _noted_scale_um(page)
        stated_um = _tagged_pitch_um(tiff, page)
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
    steps, origin = _pitch(path, pitch, stated_um)
    return HeightMap(heights, steps, f"TIFF of {stored.name}", origin)


def _from_text(path: Path, text: _TextMap, pitch: Length | None, unit: str | None) -> HeightMap:
    if text.unit is not None:
        if unit not in (None, text.unit):
            raise OptionError(
                f"{path.name} says its heights are in {text.unit}: leave out --unit {unit}"
            )
        unit = text.unit
    _check_points(path, text.values.shape)
    if unit is None:
        raise OptionError(
            f"{path.name} does not say what its numbers stand for: give --unit um (or nm, mm, m)"
        )
    unit_um = Length("1", unit).um
    stated_um = text.pitch_um
    if text.pitch is not None:
        stated_um = (text.pitch[0] * unit_um, text.pitch[1] * unit_um)
    steps, origin = _pitch(path, pitch, stated_um)
    with np.errstate(over="ignore"):
        return HeightMap(text.values * unit_um, steps, text.format, origin)


def _pitch(
    path: Path, option: Length | None, stated_um: tuple[float, float] | None
) -> tuple[tuple[float, float], str]:
    """Distance of rows and columns in um, and where it comes from: the option or the file."""
    if option is not None:
        if not _OPTION_PITCHES_UM[0] <= option.um <= _OPTION_PITCHES_UM[1]:
            raise OptionError(f"--pitch {option}: give 0.1nm to 1mm from one point to the next")
        return (option.um, option.um), "--pitch"
    if stated_um is None:
        raise OptionError(
            f"{path.name} does not say how far apart its points lie: give --pitch, such as "
            "--pitch 0.5um"
        )
    if not all(_PITCHES_UM[0] <= each <= _PITCHES_UM[1] for each in stated_um):
        raise OptionError(
            f"{path.name} says that its points lie {max(stated_um):.4g} µm apart, which is no "
            "microscope's pitch: give the right one, such as --pitch 0.5um"
        )
    return stated_um, "the file"


def _noted_scale_um(page: tifffile.TiffPage) -> tuple[float, float] | None:
    """What a value of 1 and one of 0 stand for in um, in the TIFFs of this program."""
    if page.software == SOFTWARE and page.description == HEIGHTS_IN_UM:
        return 1.0, 0.0
    note = own_note(page)
    try:
        return float(note["um_per_count"]), float(note["um_at_zero"])
    except (ValueError, LookupError, TypeError):
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


def _read_text_map(path: Path) -> _TextMap:
    """Read a text and find out what it holds."""
    lines = _lines(path)
    if not lines:
        raise FileError(f"{path} is empty: copy it again from where it was made")
    if _SDF.match(lines[0]):
        return _read_sdf(path, lines)
    header = [line for line in lines if line.lstrip().startswith("#")]
    numbered = [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise FileError(f"{path} holds no numbers: give a table of heights, or points x y z")
    table = _table(path, numbered)
    if table.shape[1] == 3:
        return _points(path, table)
    return _matrix(path, table, header)


def _lines(path: Path) -> list[str]:
    check_bytes(path, _COST)
    with system_errors(path):
        content = path.read_bytes()
    if content.startswith(_BINARY_SDF):
        raise FileError(f"{path} is a binary SDF: save it as ASCII (aISO-1.0), or as text or TIFF")
    if b"\0" in content:
        raise FileError(f"{path} is no text: save the heights as text or TIFF")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError:
        # Older instruments write the micro sign of their header so.
        text = content.decode("latin-1")
    return text.splitlines()


def _table(path: Path, numbered: Sequence[tuple[int, str]]) -> NDArray[np.float64]:
    """Numbers of lines of equal length; the first line may be words over the columns."""
    separator = _separator(numbered[0][1])
    if len(numbered) > 1 and _separator(numbered[1][1]) != separator:
        separator = _separator(numbered[1][1])
    rows = [_split(line, separator) for _, line in numbered]
    if not any(_number(field, separator) is not None for field in rows[0]):
        rows, numbered = rows[1:], numbered[1:]
    # Many instruments put a separator behind the last number too.
    if rows and len(rows[0]) > 1 and all(fields[-1:] == [""] for fields in rows):
        rows = [fields[:-1] for fields in rows]
    if not rows:
        raise FileError(f"{path} holds no numbers: give a table of heights, or points x y z")
    width = len(rows[0])
    values = np.empty((len(rows), width))
    for index, ((number, _), fields) in enumerate(zip(numbered, rows, strict=True)):
        if len(fields) != width:
            raise FileError(
                f"{path}, line {number} has {len(fields)} values, but the first one has {width}: "
                "give as many in each"
            )
        try:
            values[index] = [float(field) for field in fields]
        except ValueError:
            values[index] = [_checked(path, number, field, separator) for field in fields]
    values[~np.isfinite(values)] = np.nan
    return values


def _separator(line: str) -> str | None:
    """What stands between numbers: a semicolon, a tab, a comma, or None for blanks."""
    for candidate in (";", "\t", ","):
        if candidate in line.strip(" \r\n"):
            return candidate
    return None


def _split(line: str, separator: str | None) -> list[str]:
    if separator is None:
        return line.split()
    return [field.strip() for field in line.strip(" \r\n").split(separator)]


def _number(field: str, separator: str | None) -> float | None:
    """A number, NaN for what marks a bad point, None for anything else."""
    if field.lower() in _BAD:
        return float("nan")
    # Where commas do not separate numbers, they may be decimal ones.
    if separator in (";", "\t") and field.count(",") == 1 and "." not in field:
        field = field.replace(",", ".")
    try:
        return float(field)
    except ValueError:
        return None


def _checked(path: Path, line: int, field: str, separator: str | None) -> float:
    number = _number(field, separator)
    if number is None:
        raise FileError(
            f"{path}, line {line}: {field[:40]!r} is no number: give heights, and nan or Bad where "
            "there is none"
        )
    return number


def _matrix(path: Path, table: NDArray[np.float64], header: list[str]) -> _TextMap:
    fields = {
        key.strip("# \t").lower(): value.strip()
        for key, colon, value in (line.partition(":") for line in header)
        if colon
    }
    unit = _unit(path, fields.get("value units"))
    pitch = None
    if "width" in fields and "height" in fields:
        rows, columns = table.shape
        try:
            size = [Length.parse(fields[key]).um for key in ("height", "width")]
        except OptionError as error:
            raise FileError(f"{path}: its header is damaged: {error}") from None
        pitch = (size[0] / rows, size[1] / columns)
    kind = "data matrix of Gwyddion" if pitch is not None else "table of heights"
    return _TextMap(table, kind, unit, pitch)


def _unit(path: Path, words: str | None) -> str | None:
    if words is None:
        return None
    try:
        return Length("1", words).unit
    except OptionError:
        raise FileError(
            f"{path} says that its values are in {words!r}: heights in nm, um, mm or m are needed"
        ) from None


def _points(path: Path, table: NDArray[np.float64]) -> _TextMap:
    """Points x y z: x to the right, y downwards, in any order."""
    if bool(np.isnan(table[:, :2]).any()):
        raise FileError(f"{path} has points x y z without x or y: leave such lines out")
    places, pitches = [], []
    for name, values in (("y", table[:, 1]), ("x", table[:, 0])):
        count, pitch = _axis(values)
        if count is None:
            raise FileError(
                f"{path}: the {name} of its points x y z do not lie on a regular grid: save the "
                "heights as a table or TIFF"
            )
        places.append(np.rint((values - values.min()) / pitch).astype(np.int64))
        pitches.append(pitch)
    size = tuple(int(place.max()) + 1 for place in places)
    # As many bad points as good ones are more than any map has: this is no grid.
    if size[0] * size[1] > 2 * len(table):
        raise FileError(
            f"{path} has {len(table)} points x y z for a grid of {size[0]}×{size[1]}: save the "
            "heights as a table or TIFF"
        )
    values = np.full(size, np.nan)
    values[places[0], places[1]] = table[:, 2]
    return _TextMap(values, "points x y z", pitch=(pitches[0], pitches[1]))


def _axis(values: NDArray[np.float64]) -> tuple[int | None, float]:
    """How many places a coordinate has, and their distance; None where they are not regular."""
    different = np.unique(values)
    steps = np.diff(different)
    extent = float(different[-1] - different[0])
    # Coordinates that differ only by rounding are one place.
    steps = steps[steps > extent * 1e-6]
    if len(steps) == 0:
        return None, 0.0
    pitch = float(np.median(steps))
    count = round(extent / pitch)
    pitch = extent / max(count, 1)
    at = (values - different[0]) / pitch
    regular = bool(np.all(np.abs(at - np.rint(at)) <= max(_SPACING, 1e-3)))
    return (count + 1 if regular else None), pitch


def _read_sdf(path: Path, lines: list[str]) -> _TextMap:
    """ISO 25178-71 in ASCII: a header of ``key = value``, ``*``, the data, ``*``."""
    stars = [index for index, line in enumerate(lines) if line.strip() == "*"]
    if not stars:
        raise FileError(f"{path} has no * behind its header: it is no complete SDF")
    header = {
        key.strip().lower(): value.strip()
        for key, _, value in (line.partition("=") for line in lines[1 : stars[0]])
    }
    try:
        if max(len(value) for value in header.values()) > _LONGEST_VALUE:
            raise ValueError("a value is too long")
        columns, rows = int(header["numpoints"]), int(header["numprofiles"])
        along, across = float(header["xscale"]), float(header["yscale"])
        up = float(header["zscale"])
        if min(columns, rows) < 1:
            raise ValueError(f"{rows}×{columns} points")
    except (KeyError, ValueError) as error:
        raise FileError(
            f"{path}: its header does not say the size ({error}): NumPoints, NumProfiles, Xscale, "
            "Yscale and Zscale are needed"
        ) from None
    end = stars[1] if len(stars) > 1 else len(lines)
    tokens = " ".join(lines[stars[0] + 1 : end]).split()
    if len(tokens) != rows * columns:
        raise FileError(
            f"{path} has {len(tokens)} heights, but its header says {rows}×{columns}: copy it "
            "again from where it was made"
        )
    line = stars[0] + 2
    values = np.array([_checked(path, line, token, None) for token in tokens])
    values[~np.isfinite(values)] = np.nan
    return _TextMap(
        values.reshape(rows, columns) * up, "ISO 25178-71", "m", (across * 1e6, along * 1e6)
    )
