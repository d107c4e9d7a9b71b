"""The folders that a person named, and the paths below them that the page may use."""

import os
import shutil
import tomllib
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from nolens.errors import FileError, OptionError
from nolens.studio.schemas import CameraInfo, Entry, EntryKind, Folder, PsfInfo

WORK = "work"
"""Id of the folder that the studio writes into."""
SHOTS, CAMERAS, PICTURES, UPLOADS, JOBS = "shots", "cameras", "pictures", "uploads", "jobs"
RAW_SUFFIXES = (
    ".dng", ".cr2", ".cr3", ".crw", ".nef", ".nrw", ".arw", ".sr2", ".raf", ".rw2", ".orf",
    ".pef", ".srw", ".3fr", ".iiq", ".raw", ".npy",
)  # fmt: skip
PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".jpg", ".jpeg")
_DESCRIPTIONS = ("camera.toml", "psfs.toml")
_MOST_ENTRIES = 5000
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

    def _unused_id(self, name: str) -> str:
        name = name.lstrip(".") or "folder"
        number, found = 1, name
        while found in self._roots:
            number += 1
            found = f"{name}-{number}"
        return found

    @property
    def work(self) -> Path:
        """Folder that is written into; it may not exist yet."""
        return self._roots[WORK].path

    @property
    def folders(self) -> list[Folder]:
        """All of them, as the page sees them."""
        return [
            Folder(id=each.id, path=_text(each.path), writable=each.writable)
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
        for part in parts:
            if not part or part.startswith(".") or "\\" in part or not part.isprintable():
                raise OptionError(
                    f"{text!r} is no path here: .., hidden files and empty names are not accepted"
                )
        path = root.path.joinpath(*parts)
        try:
            path = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise FileError(f"{text} cannot be followed: {error}") from None
        if not path.is_relative_to(root.path):
            raise OptionError(f"{text!r} is a link out of its folder, which is not followed")
        if any(part.startswith(".") for part in path.relative_to(root.path).parts):
            raise OptionError(f"{text!r} is a link to a hidden file, which is not followed")
        return path

    def name_of(self, path: Path) -> str | None:
        """Path of the page for a file, or None where it lies in no folder of it."""
        with suppress(OSError, RuntimeError, ValueError):
            path = path.resolve()
        for root in self._roots.values():
            if path.is_relative_to(root.path):
                return "/".join((root.id, *path.relative_to(root.path).parts))
        return None

    def named(self, value: Any) -> Any:
        """A value of JSON in which every path to a named folder is the page's."""
        if isinstance(value, dict):
            return {key: self.named(each) for key, each in value.items()}
        if isinstance(value, list):
            return [self.named(each) for each in value]
        if isinstance(value, str) and value.startswith("/") and "\n" not in value:
            return self.name_of(Path(value)) or value
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
        found = []
        try:
            names = sorted(each.name for each in path.iterdir())
        except OSError as error:
            raise FileError(f"cannot read {text}: {error.strerror or error}") from None
        for name in names:
            with suppress(OptionError, FileError, OSError):
                found.append(self._entry(f"{text}/{name}", name))
            if len(found) == _MOST_ENTRIES:
                break
        return found

    def _entry(self, text: str, name: str) -> Entry:
        path = self.resolve(text)
        about = path.stat()
        return Entry(
            name=name, path=text, kind=_kind(path), changed=about.st_mtime,
            bytes=0 if path.is_dir() else about.st_size,
        )  # fmt: skip

    def make(self, name: str) -> Path:
        """A folder of the workspace, made where it is missing.

        Raises
        ------
        FileError
            If it cannot be made.
        """
        folder = self.work / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise FileError(f"cannot make {folder}: {error.strerror or error}") from None
        return folder

    def cameras(self) -> list[CameraInfo]:
        """Presets, and camera folders: those in ``cameras/`` and beside it in every folder."""
        found = [_preset(path.stem, path.read_text(encoding="utf-8")) for path in _preset_files()]
        for root in self._roots.values():
            for above in (CAMERAS, ""):
                folder = root.path / above
                text = f"{root.id}/{above}".rstrip("/")
                if folder.is_dir():
                    found += [
                        _camera(each.path, root.path / each.path.removeprefix(f"{root.id}/"))
                        for each in self.listing(text)
                        if each.kind == "camera"
                    ]
        return found

    def presets(self) -> list[str]:
        """Names of the cameras that come with the package."""
        return [path.stem for path in _preset_files()]

    def remove_job(self, identity: str) -> None:
        """Take away the folder of a job."""
        folder = self.work / JOBS / identity
        if folder.is_dir() and not folder.is_symlink():
            shutil.rmtree(folder, ignore_errors=True)


_OWN = (SHOTS, CAMERAS, PICTURES, UPLOADS, JOBS)


def unused(folder: Path, stem: str) -> str:
    """A stem that no file in a folder has: this one, or with -2, -3 and so on."""
    names = [each.name for each in folder.iterdir()] if folder.is_dir() else []
    number, found = 1, stem
    while any(name == found or name.startswith(f"{found}.") for name in names):
        number += 1
        found = f"{stem}-{number}"
    return found


def _kind(path: Path) -> EntryKind:
    if path.is_dir():
        return "camera" if any((path / name).is_file() for name in _DESCRIPTIONS) else "folder"
    suffix = path.suffix.lower()
    if suffix in RAW_SUFFIXES:
        return "raw"
    if suffix in PICTURE_SUFFIXES:
        return "picture"
    return "record" if suffix == ".json" else "other"


def _text(path: Path) -> str:
    return os.fsencode(path).decode("utf-8", "replace")


def _preset_files() -> Iterator[Path]:
    # Not through nolens.camera, which loads the numerics.
    folder = Path(str(files("nolens"))) / "camera" / "presets"
    return iter(sorted(folder.glob("*.toml")))


def _preset(name: str, text: str) -> CameraInfo:
    return CameraInfo(id=name, name=name, note=str(tomllib.loads(text).get("note", "")), psfs=[])


def _camera(identity: str, folder: Path) -> CameraInfo:
    described = _toml(folder / "camera.toml")
    listed = _toml(folder / "psfs.toml").get("psf", [])
    psfs = [
        PsfInfo(
            path=f"{identity}/{each['file']}",
            distance=str(each.get("distance", "")),
            angle=[str(angle) for angle in each.get("angle", [])],
        )
        for each in (listed if isinstance(listed, list) else [])
        if isinstance(each, dict) and isinstance(each.get("file"), str)
    ]
    note = str(described.get("note", ""))
    return CameraInfo(id=identity, name=folder.name, note=note, psfs=psfs)


def _toml(path: Path) -> dict[str, Any]:
    with suppress(OSError, ValueError):
        return tomllib.loads(path.read_text(encoding="utf-8"))
    return {}
