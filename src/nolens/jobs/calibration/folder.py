"""The folder that a camera's PSFs are gathered in."""

from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path
from typing import Any

from torch import Tensor

from nolens.camera import Frame, OpenCamera, PsfEntry, PsfSet
from nolens.errors import DataError, FileError, OptionError
from nolens.files import CAMERA_FILE, PSFS_FILE, read_camera, read_psf_set, write_psfs
from nolens.jobs.run import Product, Value, Writer
from nolens.quantities import Length


def folder_camera(folder: Path) -> OpenCamera | None:
    """The camera of a folder of PSFs, if it has one.

    Raises
    ------
    NolensError
        If the folder's camera.toml is none.
    """
    path = folder / CAMERA_FILE
    return read_camera(path) if path.is_file() else None


def folder_psfs(folder: Path) -> PsfSet | None:
    """The list of a folder's PSFs, if it has one.

    Raises
    ------
    NolensError
        If the folder's psfs.toml is none.
    """
    return read_psf_set(folder) if (folder / PSFS_FILE).is_file() else None


def added(
    value: Value,
    figures: Mapping[str, Any],
    folder: Path,
    psfs: Mapping[PsfEntry, Tensor],
    more: Mapping[str, Writer] | None = None,
) -> Product[Value]:
    """What a job hands over that adds PSFs to a folder and to its list.

    Parameters
    ----------
    value, figures
        As of `Product`.
    folder
        Of the PSFs.
    psfs
        (channels, rows, columns) for each entry.
    more
        What writes further files, by name in the folder.
    """
    writers = {folder / name: write for name, write in (more or {}).items()}
    outputs = (*(folder / entry.file for entry in psfs), folder / PSFS_FILE, *writers)

    def commit(writers: Mapping[Path, Writer]) -> None:
        names = {str(path.relative_to(folder)): write for path, write in writers.items()}
        write_psfs(folder, psfs, more=names)

    return Product(value, figures, writers, outputs=outputs, commit=commit)


def chosen_camera(folder: Path, given: str | None) -> tuple[OpenCamera | None, str | None]:
    """The camera that PSFs are measured of, and from where it is to be copied into the folder.

    Parameters
    ----------
    folder
        Of the PSFs.
    given
        Name of a camera; None takes the folder's.

    Raises
    ------
    NolensError
        If it cannot be read, or the folder has the description of another one.
    """
    own = folder_camera(folder)
    if given is None:
        return own, None
    opened = read_camera(given)
    if own is None:
        return opened, given
    if own.camera != opened.camera:
        raise OptionError(
            f"--camera {given} is not the camera that {folder / CAMERA_FILE} describes: leave "
            "--camera out, or give another folder (-o)"
        )
    return own, None


def check_free(folder: Path, names: list[str]) -> None:
    """Refuse to write a camera's files over others.

    Raises
    ------
    FileError
        If one of them is there.
    """
    for name in names:
        if (folder / name).exists():
            raise FileError(
                f"the camera's {name} would overwrite {folder / name}: give another folder (-o)"
            )


def cell_of(
    frame: Frame, opened: OpenCamera | None, psfs: PsfSet | None, pixel: Length | None
) -> Length:
    """Distance of the cells of the reconstruction: of a frame's pixels, or of its 2×2 cells.

    Parameters
    ----------
    frame
        A frame of the camera.
    opened
        The camera, if it is known.
    psfs
        PSFs of the same camera, if there are any.
    pixel
        Distance of the frame's pixels, if it is given.

    Raises
    ------
    NolensError
        If nothing says it, or the frame's size or pixels are not the camera's.
    """
    per_cell = 1 if frame.mosaic is None else 2
    given = None if pixel is None else _times(pixel, per_cell)
    known: Length | None = None
    if opened is not None:
        known = _cell_of_camera(frame, opened)
        named = f"the camera {opened.camera.name!r}"
    elif psfs is not None:
        known, named = psfs.psf[0].cell, f"the PSF {psfs.psf[0].file}"
    if given is None and known is None:
        raise OptionError(
            "the distance of the pixels is not known: give it (--pixel 1.55um), or the camera "
            "(--camera)"
        )
    if given is not None and known is not None and given != known:
        each = "a pixel" if per_cell == 1 else "2 of its pixels"
        raise OptionError(
            f"--pixel {pixel}: a cell of {named} is {known} wide, but {each} are {given}; leave "
            "--pixel out, or give another folder (-o)"
        )
    cell = given if known is None else known
    assert cell is not None
    if psfs is not None and psfs.psf[0].cell != cell:
        raise DataError(
            f"the PSF {psfs.psf[0].file} of the folder has cells of {psfs.psf[0].cell}, but these "
            f"frames {cell}: they are of another camera. Give another folder (-o)"
        )
    return cell


def _cell_of_camera(frame: Frame, opened: OpenCamera) -> Length:
    sensor = opened.camera.sensor
    pixels = 1 if sensor.mosaic == "none" else 2
    if frame.mosaic is None and frame.channels == ("R", "G", "B") and pixels == 2:
        size, what = (sensor.rows // 2, sensor.columns // 2), "cells"
    else:
        size, what = (sensor.rows, sensor.columns), "pixels"
    if tuple(frame.counts.shape[-2:]) != size:
        raise DataError(
            f"{frame.source} has {frame.size_text} pixels, but the camera "
            f"{opened.camera.name!r} has {size[0]}×{size[1]} {what}: give frames of this "
            "camera, whole and not binned"
        )
    if frame.mosaic is not None and frame.mosaic != sensor.mosaic:
        raise DataError(
            f"{frame.source} has the colour mosaic {frame.mosaic}, but the camera "
            f"{opened.camera.name!r} has {sensor.mosaic}: give frames of this camera, not turned"
        )
    return _times(sensor.pitch, pixels)


def _times(length: Length, factor: int) -> Length:
    return Length(f"{(Decimal(length.number) * factor).normalize():f}", length.unit)
