"""Reading and writing cameras: a folder with camera.toml and the files it names."""

import difflib
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

import numpy as np
import tifffile
import torch
from torch import Tensor

from nolens.camera import (
    PRESETS,
    Camera,
    CurveFile,
    OpenCamera,
    ReliefFile,
    camera_from_toml,
    camera_to_toml,
    preset,
)
from nolens.errors import DataError, FileError
from nolens.files.folder import write_into
from nolens.files.read import read_frame
from nolens.files.read_curve import read_angular_curve, read_spectral_curve
from nolens.files.text_file import read_text

CAMERA_FILE = "camera.toml"
"""Name of a camera's description in its folder."""
HEIGHTS_IN_UM = "heights in um"
"""Description of a TIFF that holds a camera's relief."""
_HIGHEST_UM = 1e5


def read_camera(given: str | Path) -> OpenCamera:
    """Read a camera and all files it names.

    Parameters
    ----------
    given
        Name of a preset, a folder with camera.toml, or a .toml file. For a folder that is named
        like a preset, give ``./paper`` as text or its whole path.

    Raises
    ------
    FileError
        If there is no such camera, or a file it names is missing or cannot be read.
    DataError
        If the description is no camera, or a file holds what cannot be part of one.
    """
    if str(given) in PRESETS:
        return _open(preset(str(given)), Path())
    path = _find(given)
    return _open(camera_from_toml(read_text(path), str(path)), path.parent)


def camera_files(given: str | Path, camera: Camera) -> dict[str, Path]:
    """Files that a camera was read from, by their role; none for a preset.

    Parameters
    ----------
    given
        What `read_camera` was given.
    camera
        The description it gave.
    """
    if str(given) in PRESETS:
        return {}
    path = _find(given)
    named = {name: path.parent / name for name in _named(camera)}
    return {"camera": path} | {f"camera's {name}": file for name, file in named.items()}


def write_camera(
    folder: str | Path,
    camera: Camera,
    relief_um: Tensor | None = None,
    *,
    more: Mapping[str, Callable[[Path], None]] | None = None,
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
    writers: dict[Path, Callable[[Path], None]] = {
        folder / CAMERA_FILE: partial(write_description, camera=camera)
    }
    if relief_um is not None:
        if not isinstance(relief, ReliefFile):
            raise DataError(
                f"heights are given for the camera {camera.name!r}, whose relief is of kind "
                f"{relief.kind}: describe it as kind file"
            )
        heights = _heights(relief_um[None], f"the relief of {camera.name!r}")
        writers[folder / relief.file] = lambda path: _write_heights(path, heights)
    writers |= {folder / name: write for name, write in (more or {}).items()}
    for name in _named(camera):
        if folder / name not in writers and not (folder / name).is_file():
            raise FileError(
                f"the camera {camera.name!r} names the file {name}, which is not in {folder}: "
                "put it there first"
            )
    write_into(folder, writers)


def write_description(path: Path, camera: Camera) -> None:
    """Write camera.toml alone, where the files that it names are written beside it."""
    path.write_text(camera_to_toml(camera), encoding="utf-8", newline="\n")


def _find(given: str | Path) -> Path:
    path = Path(given)
    try:
        path = path.expanduser()
        if path.is_dir():
            if (path / CAMERA_FILE).is_file():
                return path / CAMERA_FILE
            raise FileError(f"the folder {path} holds no {CAMERA_FILE}. {_accepted()}")
        if path.is_file():
            if path.suffix.lower() == ".toml":
                return path
            raise FileError(f"{path} is no .toml file. {_accepted()}")
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    # No such user, or a character that no path can have: then there is no such camera.
    except (RuntimeError, ValueError):
        pass
    near = difflib.get_close_matches(str(given).lower(), PRESETS, n=1)
    meant = f" Did you mean the preset {near[0]!r}?" if near else ""
    raise FileError(f"there is no camera {str(given)!r}.{meant} {_accepted()}")


def _accepted() -> str:
    return (
        f"Give a folder with a {CAMERA_FILE}, a .toml file, or one of the presets "
        f"{', '.join(PRESETS)}"
    )


def _open(camera: Camera, folder: Path) -> OpenCamera:
    efficiency, acceptance = camera.sensor.quantum_efficiency, camera.sensor.acceptance
    if isinstance(efficiency, CurveFile):
        efficiency = read_spectral_curve(folder / efficiency.file, camera.sensor)
    if isinstance(acceptance, CurveFile):
        acceptance = read_angular_curve(folder / acceptance.file)
    relief = camera.mask.relief
    heights = _read_heights(folder / relief.file) if isinstance(relief, ReliefFile) else None
    return OpenCamera(camera, efficiency, acceptance, heights)


def _named(camera: Camera) -> list[str]:
    """Files that a camera names."""
    parts = (camera.sensor.quantum_efficiency, camera.sensor.acceptance, camera.mask.relief)
    return [part.file for part in parts if isinstance(part, CurveFile | ReliefFile)]


def _read_heights(path: Path) -> Tensor:
    return _heights(read_frame(path).counts, str(path))


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


def _write_heights(path: Path, heights: Tensor) -> None:
    tifffile.imwrite(
        path,
        np.ascontiguousarray(heights.numpy()),
        photometric="minisblack",
        description=HEIGHTS_IN_UM,
        metadata=None,
        software="nolens",
    )
