"""Reading and writing the PSFs of a camera: psfs.toml and the files it lists."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from torch import Tensor

from nolens.camera import PsfEntry, PsfSet, psf_set_from_toml, psf_set_to_toml
from nolens.camera.explain import psf_set_from_mapping
from nolens.errors import DataError
from nolens.files.folder import write_into
from nolens.files.read import read_frame
from nolens.files.text_file import read_text
from nolens.files.write import write_tiff32

PSFS_FILE = "psfs.toml"
"""Name of the list of PSFs in a camera's folder."""


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
    return psf_set_from_toml(read_text(path, advice=advice), str(path))


def read_psf(folder: str | Path, entry: PsfEntry) -> Tensor:
    """Read one PSF of a folder: float32, (channels, rows, columns).

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
    return frame.counts


def write_psfs(
    folder: str | Path,
    psfs: Mapping[PsfEntry, Tensor],
    *,
    more: Mapping[str, Callable[[Path], None]] | None = None,
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
    kept = [each for each in before if not any(new.replaces(each) for new in entries)]
    together = psf_set_from_mapping({"psf": [*kept, *entries]}, str(listed))
    text = psf_set_to_toml(together)
    writers: dict[Path, Callable[[Path], None]] = {listed: lambda path: _write_text(path, text)}
    writers |= {folder / each.file: partial(write_tiff32, radiance=psfs[each]) for each in entries}
    writers |= {folder / name: write for name, write in (more or {}).items()}
    write_into(folder, writers)


def _write_text(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="\n")
