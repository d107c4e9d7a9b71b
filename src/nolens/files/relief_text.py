"""Text of height maps: tables, points, Gwyddion's data matrix and `iso25178-71`."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nolens.errors import FileError, OptionError
from nolens.files.limits import check_bytes
from nolens.quantities import Length

TEXT_SUFFIXES = (".txt", ".csv", ".tsv", ".asc", ".xyz", ".dat", ".sdf")
"""Suffixes of texts that are read."""

_BAD = frozenset({"", "bad", "nan", "n/a", "na", "null", "none", "---", "inf", "-inf"})
_SDF = re.compile(r"^\s*[aA](ISO|BCR)-1\.0\s*$")
_BINARY_SDF = (b"bISO-1.0", b"bBCR-1.0")
_COST = 10
"""Bytes of memory for one of a text, most of them for the numbers as texts of their own."""
_LONGEST_VALUE = 1000
_SPACING = 1e-3
"""Fraction of the pitch by which points may lie beside their grid."""


@dataclass(frozen=True)
class TextMap:
    """Numbers of a text and what it says of them.

    Parameters
    ----------
    values
        (rows, columns), NaN where the text marks points as bad.
    format
        What the text was taken for.
    unit
        Of the values; None where the text does not say it.
    pitch_um
        Distance of rows and columns in um, where the text says it.
    pitch
        The same in the unit of the values.
    """

    values: NDArray[np.float64]
    format: str
    unit: str | None = None
    pitch_um: tuple[float, float] | None = None
    pitch: tuple[float, float] | None = None


def read_text_map(path: Path) -> TextMap:
    """Read a text and find out what it holds.

    Raises
    ------
    FileError
        If the file is no text, or no map of heights.
    """
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
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
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


def _matrix(path: Path, table: NDArray[np.float64], header: list[str]) -> TextMap:
    said = {
        key.strip("# \t").lower(): value.strip()
        for key, colon, value in (line.partition(":") for line in header)
        if colon
    }
    unit = _unit(path, said.get("value units"))
    pitch = None
    if "width" in said and "height" in said:
        rows, columns = table.shape
        try:
            size = [Length.parse(said[key]).um for key in ("height", "width")]
        except OptionError as error:
            raise FileError(f"{path}: its header is damaged: {error}") from None
        pitch = (size[0] / rows, size[1] / columns)
    kind = "data matrix of Gwyddion" if pitch is not None else "table of heights"
    return TextMap(table, kind, unit, pitch)


def _unit(path: Path, said: str | None) -> str | None:
    if said is None:
        return None
    try:
        return Length("1", said).unit
    except OptionError:
        raise FileError(
            f"{path} says that its values are in {said!r}: heights in nm, um, mm or m are needed"
        ) from None


def _points(path: Path, table: NDArray[np.float64]) -> TextMap:
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
    return TextMap(values, "points x y z", pitch=(pitches[0], pitches[1]))


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


def _read_sdf(path: Path, lines: list[str]) -> TextMap:
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
    return TextMap(
        values.reshape(rows, columns) * up, "ISO 25178-71", "m", (across * 1e6, along * 1e6)
    )
