"""Sequences of frames: folders, TIFF of many pages, npy of many frames."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.check_input import check_exists
from nolens.files.read import declared, frame_suffixes, read_frame
from nolens.files.read_npy import frame_of_npy, open_npy
from nolens.files.read_tiff import count_pages, read_tiff

_TIFF = (".tif", ".tiff")
_NARROWEST = 16
"""Columns of a frame: a shorter last axis is channels, which one picture has too many of."""


@dataclass(frozen=True)
class FrameSequence:
    """Frames in the order in which they were taken, read one at a time.

    Parameters
    ----------
    names
        One for each frame, for messages and files.
    sources
        The files they are in: one for each frame of a folder, or the stack's.
    read
        Gives a frame by its number, from 0.
    """

    names: tuple[str, ...]
    sources: tuple[Path, ...]
    read: Callable[[int], Frame]


def is_sequence(path: Path) -> bool:
    """Whether a path is a folder, or a file with more than one frame."""
    if path.is_dir():
        return True
    if not path.is_file():
        return False
    suffix = path.suffix.lower()
    if suffix == ".npy":
        shape = open_npy(path).shape
        frames = len(shape) == 3 and not {shape[0], shape[2]} & {1, 3}
        return len(shape) == 4 or (frames and shape[2] >= _NARROWEST)
    return suffix in _TIFF and count_pages(path) > 1


def open_sequence(path: Path, *, mosaic: str | None = None, bgr: bool = False) -> FrameSequence:
    """Find the frames of a folder or a stack.

    A folder's frames are its files that `read_frame` knows, sorted by name with numbers in them
    counted as such; other files are passed over. A stack is a TIFF of many pages, or an npy of
    (frames, height, width), (frames, height, width, 1 or 3) or (frames, 1 or 3, height, width).

    Parameters
    ----------
    path
        The folder or file.
    mosaic, bgr
        As `read_frame` takes them.

    Raises
    ------
    FileError
        If there is none, or it holds no frames.
    """
    if path.is_dir():
        return _of_folder(path, mosaic, bgr)
    check_exists(path, "Accepted are a folder of frames, and a .tif or .npy of many")
    suffix = path.suffix.lower()
    if suffix == ".npy":
        stack = open_npy(path)
        count = len(stack)

        def read(number: int) -> Frame:
            return frame_of_npy(stack[number], f"{path}, frame {number + 1}")
    else:
        count = count_pages(path)

        def read(number: int) -> Frame:
            return read_tiff(path, number)

    if count == 0:
        raise FileError(f"{path} holds no frame: give a stack of one or more")
    digits = len(str(count))
    return FrameSequence(
        tuple(f"frame-{number + 1:0{digits}}" for number in range(count)),
        (path,),
        lambda number: declared(read(number), mosaic=mosaic, bgr=bgr),
    )


def _of_folder(folder: Path, mosaic: str | None, bgr: bool) -> FrameSequence:
    try:
        files = sorted(
            (
                each
                for each in folder.iterdir()
                if each.suffix.lower() in frame_suffixes() and not each.name.startswith(".")
            ),
            key=lambda each: [
                (int(part), "") if part.isdigit() else (-1, part)
                for part in re.split(r"(\d+)", each.name)
                if part
            ],
        )
    except OSError as error:
        raise FileError(f"cannot read {folder}: {error.strerror or error}") from error
    if not files:
        raise FileError(
            f"the folder {folder} holds no frame; its files can be "
            f"{', '.join(sorted(frame_suffixes()))}"
        )
    stems = [each.stem for each in files]
    names = tuple(
        each.stem if stems.count(each.stem) == 1 else each.name.replace(".", "-") for each in files
    )
    return FrameSequence(
        names, tuple(files), lambda number: read_frame(files[number], mosaic=mosaic, bgr=bgr)
    )
