"""Curves of a sensor from CSV files."""

import csv
import io
from collections.abc import Mapping
from pathlib import Path
from typing import TypeVar

from pydantic import ValidationError

from nolens.camera import AngularCurve, Sensor, SpectralCurve
from nolens.camera.explain import explain
from nolens.errors import DataError, FileError
from nolens.files.text_file import read_text

_LONGEST = 1_000_000
_Curve = TypeVar("_Curve", SpectralCurve, AngularCurve)


def read_spectral_curve(path: Path, sensor: Sensor) -> SpectralCurve:
    """Read a table with the columns ``wavelength_nm,R,G,B`` or ``wavelength_nm,grey``.

    Parameters
    ----------
    path
        The file.
    sensor
        Says which channels there must be.

    Raises
    ------
    FileError
        If the file is missing or no such table.
    DataError
        If its values cannot be a quantum efficiency.
    """
    columns, lines = _read_table(path, ("wavelength_nm", *sensor.channels))
    wavelengths = columns.pop("wavelength_nm")
    about = {"source": path.name, "wavelength_nm": wavelengths, "values": columns}
    return _check(SpectralCurve, about, path, lines)


def read_angular_curve(path: Path) -> AngularCurve:
    """Read a table with the columns ``angle_deg,response``.

    Raises
    ------
    FileError
        If the file is missing or no such table.
    DataError
        If its values cannot be the response of a pixel.
    """
    columns, lines = _read_table(path, ("angle_deg", "response"))
    return _check(AngularCurve, {"source": path.name, **columns}, path, lines)


def _read_table(path: Path, names: tuple[str, ...]) -> tuple[dict[str, list[float]], list[int]]:
    """Columns of numbers by name, and the number of the line each row stands on."""
    rows: list[list[float]] = []
    lines: list[int] = []
    header = None
    for line, fields in _read_lines(path):
        if header is None:
            header = fields
            if sorted(header) != sorted(names):
                raise FileError(
                    f"{path}, line {line}: the columns are {','.join(header)}; accepted for this "
                    f"camera are {','.join(names)}"
                )
        else:
            rows.append(_numbers(path, line, fields, header))
            lines.append(line)
    if header is None or not rows:
        raise FileError(f"{path} holds no numbers: give a line {','.join(names)}, then the values")
    return {name: [row[header.index(name)] for row in rows] for name in names}, lines


def _read_lines(path: Path) -> list[tuple[int, list[str]]]:
    # Spreadsheets put a mark before UTF-8 text.
    text = read_text(path, "CSV file", "The camera names it").removeprefix("\ufeff")
    if len(text) > _LONGEST:
        raise FileError(
            f"{path} has {len(text)} characters: the table of a curve may have {_LONGEST}"
        )
    reader = csv.reader(io.StringIO(text, newline=""))
    try:
        return [
            (reader.line_num, [field.strip() for field in fields])
            for fields in reader
            if any(field.strip() for field in fields)
        ]
    except csv.Error as error:
        raise FileError(f"{path} is no CSV file: {error}") from error


def _numbers(path: Path, line: int, fields: list[str], header: list[str]) -> list[float]:
    if len(fields) != len(header):
        raise FileError(
            f"{path}, line {line} has {len(fields)} values, but there are {len(header)} columns: "
            f"give {','.join(header)}"
        )
    numbers = []
    for name, field in zip(header, fields, strict=True):
        try:
            numbers.append(float(field))
        except ValueError:
            raise FileError(
                f"{path}, line {line}: {name} is {field!r}: give a number such as 0.5"
            ) from None
    return numbers


def _check(
    model: type[_Curve], about: Mapping[str, object], path: Path, lines: list[int]
) -> _Curve:
    try:
        return model.model_validate(about)
    except ValidationError as error:
        first = error.errors()[0]
        row = next((step for step in reversed(first["loc"]) if isinstance(step, int)), None)
        if row is None:
            row = first.get("ctx", {}).get("row")
        place = str(path) if row is None else f"{path}, line {lines[row]}"
        raise DataError(f"{place}: {explain(error)}") from None
