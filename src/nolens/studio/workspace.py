"""The folders that a person named, the paths below them that the page may use, and the links that
may be followed there.
"""

import os
import shutil
import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from nolens.documents import parse_toml
from nolens.errors import DataError, FileError, NolensError, OptionError
from nolens.files.formats import READERS
from nolens.files.input import read_text, readable
from nolens.studio.schemas import CameraInfo, Entry, EntryKind, Folder, PsfInfo

WORK = "work"
"""Id of the folder that the studio writes into."""
SHOTS, CAMERAS, PICTURES, UPLOADS, JOBS = "shots", "cameras", "pictures", "uploads", "jobs"
CALIBRATION = "calibration"
"""Frames of a calibration: of the point source and dark ones. They are no photographs."""
PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
RAW_SUFFIXES = tuple(each for each in READERS if each not in PICTURE_SUFFIXES)
_CAMERA, _PSFS = "camera.toml", "psfs.toml"
TIFF_SUFFIXES = (".tif", ".tiff")
_TIFF_HEAD = 4096
_MOST_ENTRIES = 5000
_MOST_CAMERAS = 500
_LONGEST = 1000


@dataclass(frozen=True)
class _Root:
    id: str
    path: Path
    writable: bool


class Workspace:
    """Folders by their ids; a path is ``"ID/relative/path"`` and never leaves its folder.

    Parameters
    ----------
    folders
        The first is written into, and made when that first happens. The others are only read.

    Raises
    ------
    FileError
        If one is a file, or another than the first does not exist.
    """

    def __init__(self, folders: Sequence[Path]) -> None:
        self._roots: dict[str, _Root] = {}
        for number, folder in enumerate(folders):
            if folder.exists() and not folder.is_dir():
                raise FileError(f"{folder} is a file: give the name of a folder")
            if number > 0 and not folder.exists():
                raise FileError(
                    f"there is no folder {folder}: only the first folder, which the studio writes "
                    "into, is made where it is missing"
                )
            name = WORK if number == 0 else self._unused_id(folder.resolve().name)
            self._roots[name] = _Root(name, folder.resolve(), number == 0)
        self._cameras: dict[str, tuple[object, CameraInfo]] = {}

    def _unused_id(self, name: str) -> str:
        name = name.lstrip(".") or "folder"
        number, candidate = 1, name
        while candidate in self._roots:
            number += 1
            candidate = f"{name}-{number}"
        return candidate

    @property
    def work(self) -> Path:
        """Folder that is written into; it may not exist yet."""
        return self._roots[WORK].path

    @property
    def paths(self) -> list[str]:
        """Absolute paths of all of them, without links."""
        return [str(each.path) for each in self._roots.values()]

    @property
    def folders(self) -> list[Folder]:
        """All of them, as the page sees them."""
        return [
            Folder(id=each.id, path=readable(each.path), writable=each.writable)
            for each in self._roots.values()
        ]

    def resolve(self, text: str) -> Path:
        """File or folder that a path of the page names; it must exist.

        Raises
        ------
        OptionError
            If the text is no path of the page, or leads out of its folder.
        FileError
            If there is nothing.
        """
        path = self._below(text)
        if not path.exists():
            raise FileError(f"there is no {text}")
        return path

    def _below(self, text: str) -> Path:
        first, *parts = text.split("/")
        root = self._roots.get(first)
        if root is None or len(text) > _LONGEST:
            raise OptionError(
                f"{text[:80]!r} is no path here: it begins with one of {', '.join(self._roots)}"
            )
        if not all(is_name(part) for part in parts):
            raise OptionError(
                f"{text!r} is no path here: .., hidden files and empty names are not accepted"
            )
        path = root.path.joinpath(*parts)
        try:
            real = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise FileError(f"{text} cannot be followed: {error}") from None
        reason = _leads_out(path, real, (root.path,))
        if reason is not None:
            raise OptionError(f"{text!r} {reason}")
        return real

    def name_of(self, path: Path) -> str | None:
        """Path of the page for a file, or None where it lies in no folder of it."""
        with suppress(OSError, RuntimeError, ValueError):
            path = path.resolve()
        for root in self._roots.values():
            if path.is_relative_to(root.path):
                return "/".join((root.id, *path.relative_to(root.path).parts))
        return None

    def named(self, value: Any) -> Any:
        """A value of JSON in which every path to a named folder is the page's.

        Its texts are fit to be sent: names of files can have bytes that are no UTF-8.
        """
        if isinstance(value, dict):
            return {readable(key): self.named(each) for key, each in value.items()}
        if isinstance(value, (list, tuple)):
            return [self.named(each) for each in value]
        if isinstance(value, str):
            is_path = value.startswith("/") and "\n" not in value
            return readable((self.name_of(Path(value)) if is_path else None) or value)
        return value

    def listing(self, text: str) -> list[Entry]:
        """What lies in a folder, by name; hidden files and links that lead out are left out.

        Raises
        ------
        OptionError, FileError
            As `resolve`, or if it is no folder.
        """
        path = self._below(text)
        if not path.exists() and (text == WORK or text.removeprefix(f"{WORK}/") in _OWN):
            return []
        if not path.is_dir():
            raise FileError(f"there is no folder {text}")
        return [entry for entry, _ in self._entries(path, text, _MOST_ENTRIES, lambda each: True)]

    def _entries(
        self, folder: Path, text: str, most: int, wanted: Callable[[os.DirEntry[str]], bool]
    ) -> list[tuple[Entry, Path]]:
        """What lies in a folder and is wanted, by name, and where that is."""
        try:
            with os.scandir(folder) as scanned:
                there = [each for each in scanned if wanted(each) and is_name(each.name)]
        except OSError as error:
            raise FileError(f"cannot read {text}: {error.strerror or error}") from None
        entries: list[tuple[Entry, Path]] = []
        for each in sorted(there, key=lambda each: each.name):
            with suppress(OptionError, FileError, OSError):
                entries.append(self._entry(f"{text}/{each.name}", each))
            if len(entries) == most:
                break
        return entries

    def _entry(self, text: str, there: os.DirEntry[str]) -> tuple[Entry, Path]:
        # The folder has no links on its way any more.
        path = self.resolve(text) if there.is_symlink() else Path(there.path)
        about = path.stat()
        kind = _kind(path)
        entry = Entry(
            name=there.name,
            path=text,
            kind=kind,
            changed=about.st_mtime,
            bytes=0 if kind in ("folder", "camera") else about.st_size,
        )
        return entry, path

    def make(self, name: str) -> Path:
        """A folder of the workspace, made where it is missing.

        Raises
        ------
        OptionError
            If it is a link that leads out of the workspace.
        FileError
            If it cannot be made.
        """
        folder = self._below(f"{WORK}/{name}")
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"cannot make {folder}: {error.strerror or error}") from None
        return folder

    def cameras(self) -> list[CameraInfo]:
        """Presets, and camera folders: those in ``cameras/`` and beside it in every folder."""
        cameras = list(_presets())
        for root in self._roots.values():
            for above in (CAMERAS, ""):
                text = f"{root.id}/{above}".rstrip("/")
                with suppress(OptionError, FileError):  # There is none, or it may not be read.
                    cameras += [
                        self._camera(entry, folder)
                        for entry, folder in self._entries(
                            self.resolve(text), text, _MOST_CAMERAS, lambda each: each.is_dir()
                        )
                        if entry.kind == "camera"
                    ]
        return cameras

    def _camera(self, entry: Entry, folder: Path) -> CameraInfo:
        """A camera's folder; it is read again when its files change."""
        state = [_state(folder / name) for name in (_CAMERA, _PSFS)]
        known = self._cameras.get(entry.path)
        if known is None or known[0] != state:
            known = state, self._read_camera(entry.path, entry.name)
            self._cameras[entry.path] = known
        return known[1]

    def _read_camera(self, identity: str, name: str) -> CameraInfo:
        camera = CameraInfo(id=identity, name=name, note="", psfs=[])
        troubles = []
        try:
            note = self._toml(f"{identity}/{_CAMERA}").get("note", "")
            camera.note = note if isinstance(note, str) else ""
        except NolensError as error:
            troubles.append(str(error))
        try:
            camera.psfs = _psfs(identity, self._toml(f"{identity}/{_PSFS}"))
        except NolensError as error:
            troubles.append(str(error))
        camera.trouble = readable("; ".join(troubles)) or None
        return camera

    def _toml(self, text: str) -> dict[str, Any]:
        """A description in a camera's folder, empty where there is none."""
        path = self._below(text)
        return parse_toml(read_text(path), text) if os.path.lexists(path) else {}

    def presets(self) -> list[str]:
        """Names of the cameras that come with the package."""
        return [each.id for each in _presets()]

    def remove_job(self, identity: str) -> None:
        """Take away the folder of a job."""
        with suppress(OptionError, FileError):
            shutil.rmtree(self.resolve(f"{WORK}/{JOBS}/{identity}"), ignore_errors=True)


_OWN = (SHOTS, CALIBRATION, CAMERAS, PICTURES, UPLOADS, JOBS)


class _ListedPsf(BaseModel):
    """What the page is shown of a PSF in psfs.toml; `nolens.camera` has all of it."""

    file: str
    distance: str = ""
    angle: list[str] = []


class _ListedPsfs(BaseModel):
    psf: list[_ListedPsf] = []


def unused(folder: Path, stem: str) -> str:
    """A stem that no file in a folder has: this one, or with -2, -3 and so on."""
    names = [each.name for each in folder.iterdir()] if folder.is_dir() else []
    taken = {name[:end] for name in names for end in (*_dots(name), len(name))}
    number, candidate = 1, stem
    while candidate in taken:
        number += 1
        candidate = f"{stem}-{number}"
    return candidate


def _dots(name: str) -> list[int]:
    return [place for place, each in enumerate(name) if each == "."]


def is_name(part: str) -> bool:
    """Whether a part of a path is the name of a file that is not hidden."""
    plain = bool(part) and not part.startswith(".") and "\\" not in part and "/" not in part
    return plain and part.isprintable()


def _kind(path: Path) -> EntryKind:
    if path.is_dir():
        described = any(os.path.lexists(path / name) for name in (_CAMERA, _PSFS))
        return "camera" if described else "folder"
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES or (suffix in TIFF_SUFFIXES and not _is_picture(path)):
        return "raw"
    if suffix in PICTURE_SUFFIXES:
        return "picture"
    return "record" if suffix == ".json" else "other"


def _state(path: Path) -> tuple[int, ...] | None:
    """What changes when a file does; None where there is none."""
    try:
        about = path.stat()
    except OSError:
        return None
    return about.st_mtime_ns, about.st_ctime_ns, about.st_size, about.st_ino


def _is_picture(path: Path) -> bool:
    """Whether a TIFF is a picture of ours, or a PSF, and no raw frame: its description, which is
    written before its pixels, says that it is linear.
    """
    if not path.is_file():  # Others, such as pipes, may never give anything.
        return False
    with suppress(OSError), path.open("rb") as file:
        start = file.read(_TIFF_HEAD)
        return b"nolens" in start and b'"linear": true' in start
    return False


@cache
def _presets() -> tuple[CameraInfo, ...]:
    """The cameras that come with the package."""
    # Not through nolens.camera, which loads the numerics.
    folder = Path(str(files("nolens"))) / "camera" / "presets"
    return tuple(
        CameraInfo(
            id=path.stem,
            name=path.stem,
            psfs=[],
            note=str(parse_toml(path.read_text(encoding="utf-8"), path.name).get("note", "")),
        )
        for path in sorted(folder.glob("*.toml"))
    )


def _psfs(identity: str, listed: dict[str, Any]) -> list[PsfInfo]:
    """PSFs of a list that the page can choose from."""
    try:
        psfs = _ListedPsfs.model_validate(listed).psf
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise DataError(
            f"{identity}/{_PSFS} is no list of PSFs: {place}: {first['msg'][:1].lower()}"
            f"{first['msg'][1:]}"
        ) from None
    for each in psfs:
        if not all(is_name(part) for part in each.file.split("/")):
            raise DataError(
                f"{identity}/{_PSFS} names {each.file[:80]!r}: a PSF is a file in its folder"
            )
    return [
        PsfInfo(path=f"{identity}/{each.file}", distance=each.distance, angle=each.angle)
        for each in psfs
    ]


def confine(folders: Sequence[str]) -> None:
    """Refuse to open files through links that lead out of folders, in this process, from now on.

    The server checks every path that a job is given. What a job reads beside it, such as the
    frames of a folder and the files that camera.toml and psfs.toml name, is checked here, where it
    is opened: by every reader, and also by those of libraries.

    Parameters
    ----------
    folders
        Absolute paths without links.
    """
    inside = tuple(f"{folder.rstrip(os.sep)}{os.sep}" for folder in folders)
    # An environment of Python in such a folder has links, to files that are no one's data.
    ours = f"{sys.prefix}{os.sep}"

    def check(event: str, arguments: tuple[object, ...]) -> None:
        if event != "open" or not isinstance(arguments[0], str | bytes | os.PathLike):
            return
        path = os.fsdecode(arguments[0])
        if not path.startswith(inside) or path.startswith(ours):
            return
        reason = _leads_out(Path(path), Path(os.path.realpath(path)), folders)
        if reason is not None:
            raise FileError(f"{path} {reason}")

    sys.addaudithook(check)


def _leads_out(path: Path, real: Path, folders: Iterable[str | Path]) -> str | None:
    """Why what a path leads to is not to be read; None where it is.

    Parameters
    ----------
    path
        Absolute path of a file.
    real
        It without links.
    folders
        Absolute paths without links, out of all of which it must not lead.
    """
    if real == path:
        return None
    within = next((folder for folder in folders if real.is_relative_to(folder)), None)
    if within is None:
        return "is a link out of its folder, which is not followed"
    if any(part.startswith(".") for part in real.relative_to(within).parts):
        return "is a link to a hidden file, which is not followed"
    return None
