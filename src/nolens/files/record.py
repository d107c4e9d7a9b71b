"""The record of a run: what went in, what it was asked to do, and what came of it."""

import hashlib
import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import to_json

from nolens.documents import parse_json
from nolens.errors import DataError, FileError
from nolens.files.atomic import atomic_write
from nolens.files.input import read_text, readable, system_errors

_PACKAGES = ("nolens", "torch", "numpy", "scipy", "numba")


class InputFile(BaseModel):
    """A file that went into a run: its path, its SHA-256 (hexadecimal) and its size in bytes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    path: str
    sha256: str
    size: int

    @classmethod
    def of(cls, path: str | Path) -> Self:
        """Hash a file.

        Raises
        ------
        FileError
            If it cannot be read.
        """
        with system_errors(Path(path)), Path(path).open("rb") as file:
            digest = hashlib.file_digest(file, "sha256").hexdigest()
            size = os.fstat(file.fileno()).st_size
        return cls(path=str(path), sha256=digest, size=size)


class RunRecord(BaseModel):
    """All that is needed to repeat a run and to judge it; NaN and infinity are null in JSON.

    Attributes
    ----------
    schema_version
        Version of this record's layout.
    started
        When the run began, ISO 8601 with its offset from UTC.
    inputs
        The files that went in, by role, such as ``"measurement"`` or ``"psf"``.
    versions
        Versions of the program, its libraries and the platform, as `versions` gives them.
    parameters
        Every parameter of the run.
    result
        What came out, such as the reason for stopping, seconds and written files.
    history
        One entry for each iteration: objective, residuals, penalties.
    warnings
        Texts of the warnings that were displayed.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    started: str
    inputs: dict[str, InputFile]
    versions: dict[str, str] = Field(default_factory=lambda: versions())
    parameters: dict[str, Any]
    result: dict[str, Any]
    history: list[dict[str, float]]
    warnings: list[str]


def versions() -> dict[str, str]:
    """Versions of nolens, Python and the numeric libraries, and the platform."""
    packages = {package: version(package) for package in _PACKAGES}
    return {**packages, "python": platform.python_version(), "platform": platform.platform()}


def write_record(path: str | Path, record: RunRecord) -> None:
    """Write a record as JSON.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        fields = _all_readable(record.model_dump(mode="json"))
        temporary.write_bytes(to_json(fields, indent=2, inf_nan_mode="null") + b"\n")


def read_record(path: str | Path) -> RunRecord:
    """Read the record of a run.

    Raises
    ------
    FileError
        If there is no such file, or it is no record.
    """
    try:
        return RunRecord.model_validate(parse_json(read_text(path, "JSON"), str(path)))
    except (DataError, ValidationError):
        raise FileError(
            f"{path} is no record of a run: give the .json file that a command wrote"
        ) from None


def _all_readable(value: Any) -> Any:
    """Every text in a value of JSON made `readable`: parameters and warnings hold paths."""
    if isinstance(value, dict):
        return {key: _all_readable(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_all_readable(each) for each in value]
    return readable(value) if isinstance(value, str) else value


_FORMER_KEYS = {
    "background_fraction": "background_share",
    "clipped_fraction": "clipped_share",
    "dark_fraction": "dark_share",
    "error_pixels": "error_cells",
    "extent_deg": "reach_deg",
    "extrapolated_by": "surround",
    "fft_grid": "period",
    "finest_of_the_pixels": "finest_of_the_cells",
    "fraction": "share",
    "fractions": "shares",
    "known_fraction": "known_share",
    "leave_one_out": "left_out",
    "measured_pitch_mm": "pitch_found_mm",
    "noise_known": "noise_given",
    "pixel": "cell",
    "pixel_deg": "cell_deg",
    "pixel_um": "cell_um",
    "pixels": "cells",
    "position": "found",
    "psf_pixels": "psf_cells",
    "request": "asked",
    "residual": "misfit",
    "residual_pixels": "misfit_cells",
    "residual_varying": "misfit_varying",
    "saturated_fraction": "saturated_share",
    "sensor_pixels": "sensor_cells",
    "sensor_pixels_per_pixel": "pixels_per_cell",
    "support": "region",
    "support_fraction": "support_share",
    "target_yield": "wanted_yield",
    "unknown_fraction": "unknown_share",
    "width_pixels": "width_cells",
}
"""Keys of summaries by what the version before called them."""


def with_former_keys(summary: Mapping[str, Any]) -> dict[str, Any]:
    """A summary with its figures under the keys of the version before, too.

    Scripts that read `--json` or a record go on for one version. ``former_keys`` says which keys
    are going, and what each is called now.
    """
    former: dict[str, str] = {}

    def widened(value: Any) -> Any:
        if isinstance(value, Mapping):
            items = {key: widened(each) for key, each in value.items()}
            renamed = {_FORMER_KEYS[key]: key for key in items if key in _FORMER_KEYS}
            former.update(renamed)
            return items | {old: items[new] for old, new in renamed.items()}
        return [widened(each) for each in value] if isinstance(value, list | tuple) else value

    result: dict[str, Any] = widened(summary)
    return result | ({"former_keys": dict(sorted(former.items()))} if former else {})
