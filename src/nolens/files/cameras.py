"""Cameras: a folder with camera.toml, psfs.toml and the files that they name, and materials."""

import csv
import difflib
import io
import math
import shutil
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor

from nolens.camera import (
    MATERIALS,
    PRESETS,
    AngularCurve,
    Camera,
    CurveFile,
    Filters,
    Frame,
    LoadedCamera,
    Material,
    PsfEntry,
    PsfSet,
    ReliefFile,
    Sensor,
    SpectralCurve,
    from_mapping,
    from_toml,
    material,
    preset,
    to_toml,
)
from nolens.camera.toml import explain
from nolens.errors import DataError, FileError
from nolens.files.arrays import read_npy_numbers
from nolens.files.atomic import Writer, write_into, write_text
from nolens.files.frames import read_frame
from nolens.files.input import read_text, system_errors
from nolens.files.pictures import write_tiff32
from nolens.files.tiff import HEIGHTS_IN_UM, read_tiff_samples, write_tiff

if TYPE_CHECKING:
    from nolens.twin import Light

CAMERA_FILE = "camera.toml"
"""Name of a camera's description in its folder."""
PSFS_FILE = "psfs.toml"
"""Name of the list of PSFs in a camera's folder."""
_HIGHEST_UM = 1e5
_LONGEST_TABLE = 1_000_000
_Curve = TypeVar("_Curve", SpectralCurve, AngularCurve)


def read_camera(source: str | Path) -> LoadedCamera:
    """Read a camera and all files it names.

    Parameters
    ----------
    source
        Name of a preset, a folder with camera.toml, or a .toml file. For a folder that is named
        like a preset, give ``./paper`` as text or its whole path.

    Raises
    ------
    FileError
        If there is no such camera, or a file it names is missing or cannot be read.
    DataError
        If the description is no camera, or a file holds what cannot be part of one.
    """
    if str(source) in PRESETS:
        return _load(preset(str(source)), Path())
    path = _find(source)
    return _load(read_description(path), path.parent)


def read_description(path: Path) -> Camera:
    """Read camera.toml alone, without the files that it names.

    Raises
    ------
    NolensError
        As `read_camera`.
    """
    return from_toml(Camera, read_text(path), str(path))


def camera_files(source: str | Path, camera: Camera) -> dict[str, Path]:
    """Files that `read_camera` read a camera from, by their role; none for a preset."""
    if str(source) in PRESETS:
        return {}
    path = _find(source)
    files = {f"camera's {name}": path.parent / name for name in camera.files}
    return {"camera": path} | files


def write_camera(
    folder: str | Path,
    camera: Camera,
    relief_um: Tensor | None = None,
    *,
    more: Mapping[str, Writer] | None = None,
) -> None:
    """Write camera.toml, and the relief into the file that the camera names for it.

    Parameters
    ----------
    folder
        Folder of the camera; made where it does not exist.
    camera
        Its description.
    relief_um
        Heights in um, (rows, columns), for a camera whose relief is a file. They are stored as
        32-bit floats.
    more
        Further files, by name in the folder, with what writes each when it is given a path:
        curves that the camera names, or a record. All are written, or none.

    Raises
    ------
    DataError
        If heights are given that are no such table or not finite, or for a camera whose relief
        is no file.
    FileError
        If the camera names a file that is neither written nor in the folder, or a file cannot
        be written.
    """
    folder, relief = Path(folder), camera.mask.relief
    writers: dict[Path, Writer] = {folder / CAMERA_FILE: partial(write_description, camera=camera)}
    if relief_um is not None:
        if not isinstance(relief, ReliefFile):
            raise DataError(
                f"heights are given for the camera {camera.name!r}, whose relief is of kind "
                f"{relief.kind}: describe it as kind file"
            )
        heights = _heights(relief_um[None], f"the relief of {camera.name!r}")
        writers[folder / relief.file] = partial(
            write_tiff, values=heights.numpy(), note=HEIGHTS_IN_UM
        )
    writers |= {folder / name: write for name, write in (more or {}).items()}
    for name in camera.files:
        if folder / name not in writers and not (folder / name).is_file():
            raise FileError(
                f"the camera {camera.name!r} names the file {name}, which is not in {folder}: "
                "put it there first"
            )
    write_into(folder, writers)


def write_description(path: Path, camera: Camera) -> None:
    """Write camera.toml alone, where the files that it names are written beside it."""
    write_text(path, to_toml(camera))


def curve_copies(name: str | Path, loaded: LoadedCamera) -> dict[str, Writer]:
    """What copies the curves and filters that a camera names.

    For each file, a writer for `write_camera`. `name` is what the camera was read from.
    """
    files = camera_files(name, loaded.camera)
    return {file: partial(_copy, files[f"camera's {file}"]) for file in loaded.camera.sensor.files}


def camera_copies(name: str | Path, loaded: LoadedCamera) -> dict[str, Writer]:
    """What copies a camera into a folder where something else is written; see `curve_copies`."""
    camera = loaded.camera
    writers = {CAMERA_FILE: partial(write_description, camera=camera)}
    if isinstance(camera.mask.relief, ReliefFile):
        file = camera.mask.relief.file
        writers[file] = partial(_copy, camera_files(name, camera)[f"camera's {file}"])
    return {**writers, **curve_copies(name, loaded)}


def _copy(source: Path, path: Path) -> None:
    shutil.copyfile(source, path)


def _find(source: str | Path) -> Path:
    """The description that a folder or the path of a .toml file stands for."""
    path = Path(source)
    try:
        path = path.expanduser()
        with system_errors(path):
            if path.is_dir():
                if (path / CAMERA_FILE).is_file():
                    return path / CAMERA_FILE
                raise FileError(f"the folder {path} holds no {CAMERA_FILE}. {_accepted()}")
            if path.is_file():
                if path.suffix.lower() == ".toml":
                    return path
                raise FileError(f"{path} is no .toml file. {_accepted()}")
    # No such user, or a character that no path can have: then there is no such camera.
    except (RuntimeError, ValueError):
        pass
    near = difflib.get_close_matches(str(source).lower(), PRESETS, n=1)
    meant = f" Did you mean the preset {near[0]!r}?" if near else ""
    raise FileError(f"there is no camera {str(source)!r}.{meant} {_accepted()}")


def _accepted() -> str:
    return (
        f"Give a folder with a {CAMERA_FILE}, a .toml file, or one of the presets "
        f"{', '.join(PRESETS)}"
    )


def _load(camera: Camera, folder: Path) -> LoadedCamera:
    """A camera with the files that its description names."""
    efficiency, acceptance = camera.sensor.quantum_efficiency, camera.sensor.acceptance
    if isinstance(efficiency, CurveFile):
        efficiency = _read_spectral_curve(folder / efficiency.file, camera.sensor.channels)
    if isinstance(acceptance, CurveFile):
        acceptance = _read_angular_curve(folder / acceptance.file)
    heights = None
    if isinstance(camera.mask.relief, ReliefFile):
        path = folder / camera.mask.relief.file
        heights = _heights(read_frame(path).counts, str(path))
    filters = _read_filters(folder, camera.sensor)
    return LoadedCamera(camera, efficiency, acceptance, heights, filters)


def _read_filters(folder: Path, sensor: Sensor) -> Filters | None:
    """The filters on a sensor's pixels, where it has any."""
    array = sensor.filters
    if array is None:
        return None
    curve, numbers, source = array.transmission, None, "the map of filters"
    if isinstance(curve, CurveFile):
        curve = _read_spectral_curve(folder / curve.file)
    if array.map is not None:
        source = str(folder / array.map)
        values = _map_of_filters(folder / array.map)
        numbers = values[0].long()
        if len(values) != 1 or not torch.equal(numbers.to(values), values[0]):
            raise DataError(
                f"{source} is no map of whole numbers with one channel: give the number of the "
                "filter of each pixel, from 0"
            )
    return Filters.of(array, (sensor.rows, sensor.columns), curve, numbers, source)


def _map_of_filters(path: Path) -> Tensor:
    """Numbers of filters, (channels, rows, columns), of integers of any size."""
    suffix = path.suffix.lower()
    if path.is_file() and suffix in (".npy", ".tif", ".tiff"):
        values = read_npy_numbers(path) if suffix == ".npy" else read_tiff_samples(path).values
        if values.dtype.kind in "iu":
            return torch.from_numpy(values.astype(np.int64))
    return read_frame(path).counts


def _heights(values: Tensor, source: str) -> Tensor:
    """Heights (rows, columns), float32, of a tensor (1, rows, columns)."""
    if values.ndim != 3 or len(values) != 1:
        raise DataError(
            f"{source} has (channels, rows, columns) {tuple(values.shape)}: a relief has one "
            "channel of heights in um"
        )
    heights = values[0].detach().to("cpu", torch.float32)
    if not torch.isfinite(heights).all():
        raise DataError(f"{source} holds heights that are NaN or infinite: give finite ones, in um")
    if float(heights.abs().max()) > _HIGHEST_UM:
        raise DataError(
            f"{source} holds heights of more than {_HIGHEST_UM * 1e-3:g} mm: give them in µm"
        )
    return heights


def _read_spectral_curve(path: Path, channels: tuple[str, ...] = ()) -> SpectralCurve:
    """Read a table with ``wavelength_nm,R,G,B`` or the like; without channels, with any names."""
    columns, lines = _read_table(path, ("wavelength_nm", *channels), and_others=not channels)
    wavelengths = columns.pop("wavelength_nm")
    fields = {"source": path.name, "wavelength_nm": wavelengths, "values": columns}
    return _check_curve(SpectralCurve, fields, path, lines)


def read_light(name: str) -> "Light":
    """The spectrum that a name stands for, or that a .csv with ``wavelength_nm,power`` has.

    Raises
    ------
    NolensError
        If there is neither.
    """
    # Most of what reads cameras needs no simulation.
    from nolens.twin import POWER, Light

    path = Path(name)
    if path.suffix.lower() != ".csv":
        return Light(name)
    columns, lines = _read_table(path, ("wavelength_nm", POWER))
    power = columns.pop(POWER)
    peak = max(power)
    if not 0 < peak < math.inf:
        raise DataError(f"{path} holds no light: give a {POWER} above 0, and no negative one")
    values = {POWER: [each / peak for each in power]}
    fields = {"source": path.name, **columns, "values": values}
    return Light(path.name, _check_curve(SpectralCurve, fields, path, lines))


def _read_angular_curve(path: Path) -> AngularCurve:
    """Read a table with the columns ``angle_deg,response``."""
    columns, lines = _read_table(path, ("angle_deg", "response"))
    return _check_curve(AngularCurve, {"source": path.name, **columns}, path, lines)


def _read_table(
    path: Path, names: tuple[str, ...], *, and_others: bool = False
) -> tuple[dict[str, list[float]], list[int]]:
    """Columns of numbers by name, and the number of the line each row stands on."""
    rows: list[list[float]] = []
    lines: list[int] = []
    header = None
    for line, fields in _read_lines(path):
        if header is None:
            header = fields
            if and_others and len({*header, *names}) == len(header) > len(names):
                names = tuple(header)
            if sorted(header) != sorted(names):
                others = " and a column for each filter" if and_others else ""
                raise FileError(
                    f"{path}, line {line}: the columns are {','.join(header)}; accepted for this "
                    f"camera are {','.join(names)}{others}"
                )
        else:
            rows.append(_numbers(path, line, fields, header))
            lines.append(line)
    if header is None or not rows:
        raise FileError(f"{path} holds no numbers: give a line {','.join(names)}, then the values")
    return {name: [row[header.index(name)] for row in rows] for name in names}, lines


def _read_lines(path: Path) -> list[tuple[int, list[str]]]:
    """Fields of every line that has any, with its number."""
    # Spreadsheets put a mark before UTF-8 text.
    text = read_text(path, "CSV file", "The camera names it").removeprefix("\ufeff")
    if len(text) > _LONGEST_TABLE:
        raise FileError(
            f"{path} has {len(text)} characters: the table of a curve may have {_LONGEST_TABLE}"
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


def _check_curve(
    model: type[_Curve], fields: Mapping[str, object], path: Path, lines: list[int]
) -> _Curve:
    """A curve of what a table holds; errors name the line of the file."""
    try:
        return model.model_validate(fields)
    except ValidationError as error:
        first = error.errors()[0]
        row = next((step for step in reversed(first["loc"]) if isinstance(step, int)), None)
        if row is None:
            row = first.get("ctx", {}).get("row")
        place = str(path) if row is None else f"{path}, line {lines[row]}"
        raise DataError(f"{place}: {explain(error)}") from None


def read_psf_set(folder: str | Path) -> PsfSet:
    """Read the list of a folder's PSFs; `read_psf` reads one of them.

    Raises
    ------
    FileError
        If there is no such list.
    DataError
        If it is none.
    """
    path = Path(folder) / PSFS_FILE
    advice = f"Give a folder with a {PSFS_FILE}, as nolens calibrate writes it"
    return from_toml(PsfSet, read_text(path, advice=advice), str(path))


def read_psf(folder: str | Path, entry: PsfEntry) -> Tensor:
    """Read one PSF of a folder: float32, (channels, rows, columns).

    Raises
    ------
    NolensError
        As `read_psf_frame`.
    """
    return read_psf_frame(folder, entry).counts


def read_psf_frame(folder: str | Path, entry: PsfEntry) -> Frame:
    """Read one PSF of a folder, with the size of the sensor where its file says it.

    Raises
    ------
    FileError
        If its file is missing or cannot be read.
    DataError
        If it does not hold what the list says.
    """
    frame = read_frame(Path(folder) / entry.file)
    if frame.channels != entry.channels:
        raise DataError(
            f"{frame.source} has the channels {', '.join(frame.channels)}, but {PSFS_FILE} says "
            f"{', '.join(entry.channels)}: calibrate again, or put back the file that was there"
        )
    return replace(
        frame, black=(0.0,), white=None, stored_as="float32", black_stated=True, mosaic=None
    )


def write_psfs(
    folder: str | Path,
    psfs: Mapping[PsfEntry, Tensor],
    *,
    more: Mapping[str, Writer] | None = None,
    sensor: tuple[int, int] | None = None,
) -> None:
    """Add PSFs to a folder and to its list; all are written, or none.

    Parameters
    ----------
    folder
        Made where it does not exist. PSFs of the same kind and point source are replaced.
    psfs
        (channels, rows, columns) for each entry, channels grey or R, G, B.
    more
        Further files, by name in the folder, with what writes each when it is given a path.
    sensor
        (rows, columns) of the sensor in pixels of the PSFs; None takes what the folder says.

    Raises
    ------
    DataError
        If they do not fit the PSFs that are there.
    FileError
        If a file cannot be written.
    """
    folder = Path(folder)
    listed = folder / PSFS_FILE
    entries = tuple(psfs)
    before = read_psf_set(folder).psf if listed.exists() else ()
    others = [each for each in before if not any(new.replaces(each) for new in entries)]
    together = from_mapping(PsfSet, {"psf": [*others, *entries]}, str(listed))
    text = to_toml(together)
    writers: dict[Path, Writer] = {listed: lambda path: write_text(path, text)}
    writers |= {
        folder / each.file: partial(
            write_tiff32,
            radiance=psfs[each],
            sensor=sensor or sensor_size(folder, each, psfs[each]),
        )
        for each in entries
    }
    writers |= {folder / name: write for name, write in (more or {}).items()}
    write_into(folder, writers)


def sensor_size(folder: Path, entry: PsfEntry, psf: Tensor) -> tuple[int, int] | None:
    """(rows, columns) of the folder's sensor in pixels of a PSF, where that is known."""
    if entry.kind == "captured":
        return psf.shape[-2], psf.shape[-1]
    if not (folder / CAMERA_FILE).is_file():
        return None
    sensor = read_description(folder / CAMERA_FILE).sensor
    by = max(1, round(entry.pixel.um / sensor.pitch.um))
    return sensor.rows // by, sensor.columns // by


def read_material(source: str | Path) -> Material:
    """Give a material of the package, or read one from a file.

    Parameters
    ----------
    source
        Name of a material, or a path that ends in .toml; such a file holds what
        ``nolens material show`` prints.

    Raises
    ------
    OptionError
        If there is no material of this name; with the nearest one.
    FileError
        If there is no such file, or it cannot be read.
    DataError
        If the file describes no material, or one whose name another one has.
    """
    path = Path(source)
    if str(source) in MATERIALS or path.suffix.lower() != ".toml":
        return material(str(source))
    advice = f"Give a .toml file, or one of the names {', '.join(MATERIALS)}"
    text = read_text(path, advice=advice)
    return from_toml(Material, text, str(path))
