"""Sets of pictures, read one at a time: a file, a folder, or a public data set as it was published.

Layouts, and where they are described:

- DiffuserCam Mirflickr: ``diffuser_images/imN.npy`` and ``ground_truth_lensed/imN.npy``, B, G, R,
  with ``dataset_train.csv`` and ``dataset_test.csv`` (waller-lab.github.io/LenslessLearning).
  LenslessPiCam's subset of it has ``diffuser/`` and ``lensed/``.
- LenslessPiCam's on Hugging Face (DiffuserCam, DigiCam, TapeCam, MultiLens): Parquet files
  ``data/SPLIT-00000-of-00012.parquet`` with the columns ``lensless`` and ``lensed``, each picture
  the bytes of a PNG (huggingface.co/datasets/bezzam); or folders ``lensless/`` and ``lensed/``.
- FlatNet and PhlatCam: ``caps_1cap/nX/nX_N..png`` (raw) and ``orig/nX/nX_N.JPEG``
  (github.com/siddiquesalman/flatnet: data/text_files, filenames).
"""

import csv
import io
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from nolens.errors import FileError, OptionError
from nolens.files.dataset import Shard, decode_picture, open_shard, read_dataset
from nolens.files.frames import read_frame
from nolens.files.input import check_exists, check_size, decoding, system_errors
from nolens.files.pictures import PICTURE_SUFFIXES, picture_of_samples, read_picture

_TRUTHS = ("ground_truth_lensed", "lensed", "orig", "pictures")
"""Folders of what a lensed camera saw, or a screen showed, in public data sets and in those of
`nolens collect`."""
_BGR = {"ground_truth_lensed": "diffuser_images", "lensed": "diffuser"}
"""Those whose .npy are stored as B, G, R where the other folder is beside them."""
_COLUMN = "lensed"
_LINEAR_FIRST = (".npy", ".tif", ".tiff", ".png", ".jpg", ".jpeg")
_PARQUET = "*.parquet"


@dataclass(frozen=True)
class PictureSet:
    """Pictures by name; none is held in memory.

    Parameters
    ----------
    source
        Where they are.
    names
        In their order.
    read
        Gives linear radiance, (3, rows, columns), of a name.
    """

    source: Path
    names: tuple[str, ...]
    read: Callable[[str], Tensor]


def open_pictures(path: Path, *, bgr: bool = False) -> PictureSet:
    """Find the pictures of a file, a folder or a data set; of a data set, those that are the truth.

    Of a folder that has a picture twice, as .png and as linear .tif, the linear one is taken.

    Parameters
    ----------
    path
        A picture; a folder of them; the folder of a data set, one of its Parquet files, or a .csv
        that lists some of its pictures.
    bgr
        Their channels are stored in the order B, G, R.

    Raises
    ------
    FileError
        If there is nothing, or no picture.
    OptionError
        If Parquet files are to be read, and pyarrow is missing.
    """
    suffix = path.suffix.lower()
    if path.is_dir():
        if (path / "dataset.json").is_file():
            return _of_own_set(path)
        parquet = sorted(path.glob(_PARQUET)) or sorted(path.glob(f"data/{_PARQUET}"))
        if parquet:
            return _of_parquet(path, parquet, bgr)
        truth = next((path / each for each in _TRUTHS if (path / each).is_dir()), None)
        return _of_folder(path, path if truth is None else truth, truth is not None, bgr)
    check_exists(path, f"Accepted are {', '.join(PICTURE_SUFFIXES)}, a folder, or a data set")
    if suffix == ".parquet":
        return _of_parquet(path, [path], bgr)
    if suffix == ".csv":
        return _listed(path, open_pictures(path.parent, bgr=bgr))
    return PictureSet(path, (path.stem,), lambda _: _radiance(path, bgr))


def _radiance(path: Path, bgr: bool) -> Tensor:
    radiance = read_picture(path, signed=True).radiance
    return radiance.flip(0) if bgr else radiance


def _of_folder(source: Path, folder: Path, data_set: bool, bgr: bool) -> PictureSet:
    """Pictures of a folder; those of a data set may lie in folders of their own."""
    stored_bgr = data_set and (source / _BGR.get(folder.name, "-")).is_dir()
    files: dict[str, Path] = {}
    with system_errors(folder):
        for path in sorted(folder.rglob("*") if data_set else folder.iterdir()):
            if path.suffix.lower() in PICTURE_SUFFIXES and not path.name.startswith("."):
                name = picture_name(path)
                if name not in files or _rank(path) < _rank(files[name]):
                    files[name] = path
    if not files:
        raise FileError(
            f"the folder {folder} holds no picture; its files can be {', '.join(PICTURE_SUFFIXES)}"
        )

    def read(name: str) -> Tensor:
        path = files[name]
        return _radiance(path, bgr or (stored_bgr and path.suffix.lower() == ".npy"))

    return PictureSet(source, tuple(files), read)


def _rank(path: Path) -> int:
    return _LINEAR_FIRST.index(path.suffix.lower())


def picture_name(path: Path) -> str:
    """Name of a picture, by which it belongs to others: that of its file without the suffixes."""
    return path.name.partition(".")[0]


def _listed(path: Path, every: PictureSet) -> PictureSet:
    """Those of a data set that a .csv names in its first column."""
    with system_errors(path), path.open(newline="") as file:
        rows = [picture_name(Path(row[0])) for row in csv.reader(file) if row]
    known = set(every.names)
    names = tuple(name for name in rows if name in known)
    if not names:
        raise FileError(
            f"{path} lists no picture of {every.source}: its first column is to name them"
        )
    return PictureSet(path, names, every.read)


def _of_parquet(source: Path, files: list[Path], bgr: bool) -> PictureSet:
    """Pictures of the column `lensed`, named by their files, or by split and number."""
    parts = list(_parquet_parts(files))
    names: list[str] = []
    place: dict[str, tuple[Any, int]] = {}
    stored = [name for part in parts for name in part.names]
    usable = all(stored) and len(set(stored)) == len(stored)
    counts: dict[str, int] = {}
    for part in parts:
        for row, own in enumerate(part.names):
            number = counts.get(part.split, 0)
            counts[part.split] = number + 1
            name = own if usable else f"{part.split}-{number:05}"
            names.append(name)
            place[name] = part, row

    def read(name: str) -> Tensor:
        part, row = place[name]
        radiance: Tensor = part.read(row, name)
        return radiance.flip(0) if bgr else radiance

    return PictureSet(source, tuple(names), read)


def _of_own_set(folder: Path) -> PictureSet:
    """Truths of `nolens dataset make`, times the light of each pixel that reaches the sensor."""
    about = read_dataset(folder)
    places = {
        f"{split}-{number:05}": place
        for split, each in about.splits.items()
        for number, place in enumerate(
            (shard.file, row) for shard in each.shards for row in range(shard.items)
        )
    }
    opened: dict[str, Shard] = {}

    def read(name: str) -> Tensor:
        file, row = places[name]
        if file not in opened:
            opened.clear()
            opened[file] = open_shard(folder / file)
        item = opened[file][row]
        truth = torch.from_numpy(decode_picture(item["truth"], folder / file))
        response: Tensor = read_frame(folder / about.psfs[item["psf"]].response).counts
        radiance: Tensor = truth * (item["truth_scale"] * response)
        return radiance.expand(3, -1, -1)

    return PictureSet(folder, tuple(places), read)


class _ParquetPart:
    """One Parquet file; the pictures of one row group at a time are held."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path, self._file = path, file
        self.split = path.name.partition("-")[0].removesuffix(".parquet")
        # Pictures are bytes and the name of their file, or bytes alone.
        self._bare = not hasattr(file.schema_arrow.field(_COLUMN).type, "fields")
        column = None if self._bare else file.read(columns=[f"{_COLUMN}.path"]).column(_COLUMN)
        paths = [] if column is None else [(each or {}).get("path") for each in column.to_pylist()]
        self.names = [picture_name(Path(each or "")) for each in paths] or [""] * (
            file.metadata.num_rows
        )
        self._group = -1
        self._rows: Any = None

    def read(self, row: int, name: str) -> Tensor:
        """Radiance of a row."""
        group = 0
        while row >= (count := self._file.metadata.row_group(group).num_rows):
            row, group = row - count, group + 1
        if group != self._group:
            size = self._file.metadata.row_group(group).total_byte_size
            check_size((size,), 1, f"row group {group} of {self._path}")
            with decoding(self._path, "Parquet"):
                self._rows = self._file.read_row_group(group, columns=[_COLUMN]).column(_COLUMN)
            self._group = group
        content = self._rows[row].as_py()
        if content is not None and not self._bare:
            content = content.get("bytes")
        where = f"{self._path}, {name}"
        if not content:
            raise FileError(
                f"{where} has no bytes in its column {_COLUMN}: save it with its pictures"
            )
        with decoding(Path(where), "a picture"), Image.open(io.BytesIO(content)) as picture:
            check_size((picture.height, picture.width, len(picture.getbands())), 1, where)
            samples = np.asarray(
                picture if picture.mode in ("L", "I;16") else picture.convert("RGB")
            )
        return picture_of_samples(samples if samples.ndim == 3 else samples[..., None], where)


def _parquet_parts(files: list[Path]) -> Iterator[_ParquetPart]:
    try:
        from pyarrow import parquet
    except ImportError:
        raise OptionError(
            f"{files[0]} is a Parquet file, which pyarrow reads: pip install 'nolens[parquet]'"
        ) from None
    for path in files:
        with decoding(path, "Parquet"):
            file = parquet.ParquetFile(path)
        if _COLUMN not in file.schema_arrow.names:
            raise FileError(
                f"{path} has the columns {', '.join(file.schema_arrow.names)}, and none {_COLUMN}"
            )
        with decoding(path, "Parquet"):
            part = _ParquetPart(path, file)
        yield part
