"""Writing of the displayed frame: its raw counts, its picture, and the record."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from torch import Tensor

from nolens.camera import Frame, LoadedCamera, PsfEntry, arrange_rgb
from nolens.capture import Shot
from nolens.errors import DataError, NolensError, OptionError
from nolens.files import (
    InputFile,
    RunRecord,
    check_holds,
    write_frame,
    write_into,
    write_png,
    write_psfs,
    write_record,
    write_tiff16,
)
from nolens.files.cameras import camera_copies
from nolens.files.psf_folder import PsfFolder, pixel_of_camera
from nolens.studio.live_solver import LivePicture
from nolens.studio.schemas import Settings
from nolens.studio.workspace import CAMERAS, unused


@dataclass(frozen=True)
class DisplayedFrame:
    """The frame that is displayed.

    Parameters
    ----------
    shot
        What the camera gave.
    picture
        Its reconstruction, if there is one.
    white
        Radiance that is white in it.
    settings
        It was reconstructed with.
    source
        Text of the source.
    """

    shot: Shot
    picture: LivePicture | None
    white: float
    settings: Settings
    source: str


def save_frame(
    folder: Path, displayed: DisplayedFrame, formats: list[str], psf: Path | None
) -> list[Path]:
    """Write a frame into a folder; no file is written over.

    Parameters
    ----------
    folder
        Of the workspace.
    displayed
        The frame.
    formats
        png, tiff and raw, or some of them.
    psf
        File that it was reconstructed with.

    Returns
    -------
    list
        What was written, the record last.

    Raises
    ------
    NolensError
        If there is no picture, or a file cannot be written.
    """
    shot, picture = displayed.shot, displayed.picture
    stem = unused(folder, f"{shot.taken.astimezone():%Y-%m-%d-%H%M%S}")
    writers: dict[Path, Callable[[Path], None]] = {}
    if "raw" in formats:
        writers[folder / f"{stem}{_raw_suffix(shot.frame)}"] = partial(_raw, shot)
    if {"png", "tiff"} & set(formats):
        if picture is None:
            raise DataError("there is no reconstruction to save: choose a PSF, or save the raw")
        rgb = arrange_rgb(picture.radiance, picture.channels)
        if "png" in formats:
            writers[folder / f"{stem}.png"] = partial(
                write_png, radiance=rgb, white=displayed.white
            )
        if "tiff" in formats:
            # A TIFF of counts would have the same name where the raw frame is no DNG.
            name = f"{stem}-picture.tif" if folder / f"{stem}.tif" in writers else f"{stem}.tif"
            writers[folder / name] = partial(write_tiff16, radiance=rgb)
    record = folder / f"{stem}.json"
    files = [*writers, record]
    writers[record] = partial(write_record, record=_record(displayed, files, psf))
    write_into(folder, writers)
    return files


def stored_psf(work: Path, camera: str, loaded: LoadedCamera, psf: Tensor, shot: Shot) -> Path:
    """File of a simulated camera's PSF in its folder, written where it is not there yet.

    Raises
    ------
    NolensError
        If it cannot be written.
    """
    name = f"twin-{loaded.camera.name}".replace("/", "-")
    folder = work / CAMERAS / name
    with suppress(NolensError):
        stored = PsfFolder(folder)
        if stored.psfs and stored.camera and stored.camera.camera == loaded.camera:
            return folder / stored.psfs[0].file
    folder = work / CAMERAS / unused(work / CAMERAS, name)
    distance = loaded.camera.reference_distance
    entry = PsfEntry(
        file=f"psf-{distance.mm:g}mm.tif",
        pixel=pixel_of_camera(shot.frame, loaded),
        channels=loaded.camera.sensor.channels,
        distance=distance,
    )
    write_psfs(folder, {entry: psf}, more=camera_copies(camera, loaded))
    return folder / entry.file


def _raw_suffix(frame: Frame) -> str:
    """Of a file that holds a frame as it is: DNG, or for sensors without colours TIFF, or npy."""
    for suffix in (".dng", ".tif"):
        try:
            check_holds(Path(f"raw{suffix}"), frame)
        except OptionError:
            continue
        return suffix
    return ".npy"


def _raw(shot: Shot, path: Path) -> None:
    write_frame(path, shot.frame, model=shot.camera.encode("ascii", "replace").decode())


def _record(displayed: DisplayedFrame, files: list[Path], psf: Path | None) -> RunRecord:
    shot, picture = displayed.shot, displayed.picture
    parameters: dict[str, Any] = {
        "source": displayed.source,
        "camera": shot.camera,
        "taken": shot.taken.isoformat(),
        "exposure_s": shot.exposure_s,
        "gain": shot.gain,
        "details": shot.details,
        "white_radiance": displayed.white,
        **displayed.settings.model_dump(include={"method", "detail"}),
        "tau": None if picture is None else picture.tau,
        "field_points": None if picture is None else picture.field_points,
        **({} if picture is None else picture.prior),
    }
    return RunRecord(
        started=shot.taken.isoformat(timespec="seconds"),
        inputs={} if psf is None else {"psf": InputFile.of(psf)},
        parameters=parameters,
        result={
            "iterations": None if picture is None else picture.iterations,
            "outputs": [str(path) for path in files],
        },
        history=[],
        warnings=[],
    )
