"""Formats of frames: the table of readers, frames in a file, and how one of them is named.

Nothing here loads more than the standard library, so that the studio's server can use it.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from nolens.errors import FileError
from nolens.files.input import RAW_SUFFIXES
from nolens.plugins import plugin_names

if TYPE_CHECKING:
    from nolens.camera import Frame


class Reader(NamedTuple):
    """What opens files of one kind.

    Attributes
    ----------
    opens
        ``"module:function"`` of the path, and of the name of a data set in it or None.
    kinds
        What the first bytes may be, as `check_content` takes it; nothing leaves that to the
        function.
    is_folder
        Whether it may be a folder, too.
    """

    opens: str
    kinds: tuple[str | None, ...] = (None,)
    is_folder: bool = False


_RAW = Reader("nolens.files.raw:open_raw", ("TIFF", None))
_TIFF = Reader("nolens.files.tiff:open_tiff_frames", ("TIFF",))
_HDF5 = Reader("nolens.files.hdf5:open_hdf5", ("HDF5", None))
READERS: dict[str, Reader] = {
    **dict.fromkeys(RAW_SUFFIXES, _RAW),
    **dict.fromkeys((".raw", ".bin"), Reader("nolens.files.packed:open_bare", ())),
    ".png": Reader("nolens.files.arrays:open_png", ("PNG",)),
    ".tif": _TIFF,
    ".tiff": _TIFF,
    ".npy": Reader("nolens.files.arrays:open_npy", ("npy",)),
    ".npz": Reader("nolens.files.npz:open_npz", ("zip",)),
    ".mat": Reader("nolens.files.mat:open_mat"),
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".zarr": Reader("nolens.files.zarr_store:open_zarr", is_folder=True),
    ".zip": Reader("nolens.files.zarr_store:open_zarr", ("zip",)),
    **dict.fromkeys((".mkv", ".avi", ".mov", ".mp4"), Reader("nolens.files.video:open_video")),
    ".exr": Reader("nolens.files.exr:open_exr", ("EXR",)),
    ".parquet": Reader("nolens.files.parquet:open_parquet"),
}
"""By suffix. A new format is a function and a line here."""

_ADDRESS = re.compile(r"(.+?)(?::/([^#]*))?(?:#([1-9][0-9]{0,8}))?")


@dataclass(frozen=True)
class FrameSequence:
    """Frames in the order in which they were taken, read one at a time; none is held.

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
    read: Callable[[int], "Frame"]

    def __len__(self) -> int:
        return len(self.names)


@dataclass(frozen=True)
class Address:
    """A file, and what of it is meant: ``take.h5:/raw/frames#12``.

    Attributes
    ----------
    file
        The file, or the folder of a Zarr store.
    dataset
        Name of a data set in it; None leaves that to what it holds.
    number
        One of its frames, from 1; None means all of them.
    """

    file: Path
    dataset: str | None = None
    number: int | None = None

    @classmethod
    def of(cls, path: str | Path) -> "Address":
        """Take a path apart, unless there is a file of just that name."""
        path = Path(path)
        match = _ADDRESS.fullmatch(str(path))
        if match is None or match[2] is match[3] is None or path.exists():
            return cls(path)
        file = Path(match[1])
        if file.suffix.lower() not in frame_suffixes():
            return cls(path)
        return cls(file, match[2], None if match[3] is None else int(match[3]))


def frame_suffixes() -> tuple[str, ...]:
    """Suffixes of the files that can be read, those that other packages add among them."""
    return (*READERS, *(f".{name}" for name in plugin_names("nolens.readers")))


def single(path: Path, read: "Callable[[Path], Frame]") -> FrameSequence:
    """The frame of a file that holds one."""
    return FrameSequence((path.stem,), (path,), partial(_read_single, read, path))


def _read_single(read: "Callable[[Path], Frame]", path: Path, number: int) -> "Frame":
    return read(path)


def numbered(count: int) -> tuple[str, ...]:
    """Names for the frames of a stack: frame-1 and so on, all of one length."""
    digits = len(str(count))
    return tuple(f"frame-{number + 1:0{digits}}" for number in range(count))


def picture_name(path: Path) -> str:
    """Name of a picture, by which it belongs to others: that of its file without the suffixes."""
    return path.name.partition(".")[0]


def refuse_dataset(path: Path, dataset: str | None) -> None:
    """Refuse the name of a data set for a file of a kind that has none.

    Raises
    ------
    FileError
        If there is one.
    """
    if dataset is not None:
        raise FileError(f"{path} has no data sets: leave :/{dataset} out")


def several_frames(path: Path, count: int) -> FileError:
    """Refusal of a file of many frames where one is needed."""
    if count == 0:
        return FileError(f"{path} holds no frame: give a file of one or more")
    return FileError(
        f"{path} has {count} frames, and which one to take is not said: name it, such as {path}#1"
    )
