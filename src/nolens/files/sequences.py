"""Sequences of frames: of folders, patterns, lists and stacks."""

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from functools import partial
from glob import has_magic
from pathlib import Path

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.formats import READERS, Address, FrameSequence, frame_suffixes, several_frames
from nolens.files.frames import open_file, read_frame
from nolens.files.input import read_text, system_errors

_LIST = ".txt"


def is_sequence(path: Path) -> bool:
    """Whether a path is a folder, a pattern or a list of frames, or a file with more than one.

    What cannot be opened is none: those who read it say why.
    """
    if _is_folder(path) or _is_pattern(path):
        return True
    address = Address.of(path)
    suffix = address.file.suffix.lower()
    if suffix == _LIST and suffix not in frame_suffixes():
        return path.is_file()
    if address.number is not None or suffix not in frame_suffixes() or not address.file.exists():
        return False
    try:
        return len(open_file(address)) > 1
    except FileError:
        return False


def open_sequence(path: Path, *, mosaic: str | None = None, bgr: bool = False) -> FrameSequence:
    """Find the frames of a folder, a pattern, a list or a stack.

    A folder's frames are its files that `read_frame` knows, sorted by name with numbers in them
    counted as such; other files are passed over. A pattern such as ``raw/*.png`` chooses among
    them. A list is a .txt with a path on each line, from its own folder. A stack is any other file
    that `read_frame` knows, with all its frames.

    Parameters
    ----------
    path
        The folder, pattern or file.
    mosaic, bgr
        As `read_frame` takes them.

    Raises
    ------
    FileError
        If there is none, or it holds no frames.
    """
    if _is_folder(path):
        with system_errors(path):
            files = _in_order(path.iterdir())
        if not files:
            raise FileError(f"the folder {path} holds no frame; {_accepted()}")
        return _of_files(files, mosaic, bgr)
    if _is_pattern(path):
        files = _in_order(Path(path.anchor).glob(str(path.relative_to(path.anchor))))
        if not files:
            raise FileError(f"no frame has a name like {path}; {_accepted()}")
        return _of_files(files, mosaic, bgr)
    if path.suffix.lower() == _LIST and _LIST not in frame_suffixes():
        return _of_files(_listed(path), mosaic, bgr)
    address = Address.of(path)
    frames = open_file(address, mosaic=mosaic, bgr=bgr)
    if not len(frames):
        raise several_frames(address.file, 0)
    return frames


def _is_folder(path: Path) -> bool:
    reader = READERS.get(path.suffix.lower())
    return path.is_dir() and not (reader is not None and reader.is_folder)


def _is_pattern(path: Path) -> bool:
    return has_magic(str(path)) and not path.exists()


def _accepted() -> str:
    return f"its files can be {', '.join(sorted(frame_suffixes()))}"


def _in_order(paths: Iterable[Path]) -> list[Path]:
    """Those that are frames by their names, in the order of the numbers in these."""
    suffixes = frozenset(frame_suffixes())
    return sorted(
        (e for e in paths if e.suffix.lower() in suffixes and not e.name.startswith(".")),
        key=lambda each: [
            (int(part), "") if part.isdigit() else (-1, part)
            for part in re.split(r"(\d+)", str(each))
            if part
        ],
    )


def _listed(path: Path) -> list[Path]:
    lines = (each.strip() for each in read_text(path, "list of files").splitlines())
    files = [path.parent / each for each in lines if each and not each.startswith("#")]
    if not files:
        raise FileError(f"{path} lists no file: write a path on each line")
    return files


def _of_files(files: Sequence[Path], mosaic: str | None, bgr: bool) -> FrameSequence:
    return FrameSequence(_names(files), tuple(files), partial(_read, tuple(files), mosaic, bgr))


def _read(files: Sequence[Path], mosaic: str | None, bgr: bool, number: int) -> Frame:
    return read_frame(files[number], mosaic=mosaic, bgr=bgr)


def _names(files: Sequence[Path]) -> tuple[str, ...]:
    """The shortest that is a frame's own: without suffix, with it, or with the folders."""
    ways = [
        [each.stem for each in files],
        [each.name.replace(".", "-") for each in files],
        ["-".join(each.parts).replace(".", "-").strip("/-") for each in files],
        [f"{each.stem}-{number}" for number, each in enumerate(files, start=1)],
    ]
    counted = [Counter(way) for way in ways]
    return tuple(
        next(
            way[number] for way, count in zip(ways, counted, strict=True) if count[way[number]] == 1
        )
        for number in range(len(files))
    )
