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
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from nolens.errors import FileError
from nolens.files.dataset import Shard, decode_picture, open_shard, read_dataset
from nolens.files.formats import picture_name
from nolens.files.frames import read_frame
from nolens.files.input import check_exists, check_size, decoding, system_errors
from nolens.files.parquet import ParquetTable
from nolens.files.pictures import PICTURE_SUFFIXES, picture_files, picture_of_samples, read_picture

_TRUTHS = ("ground_truth_lensed", "lensed", "orig", "pictures")
"""Folders of what a lensed camera saw, or a screen showed, in public data sets and in those of
`nolens collect`."""
_BGR = {"ground_truth_lensed": "diffuser_images", "lensed": "diffuser"}
"""Those whose .npy are stored as B, G, R where the other folder is beside them."""
_COLUMN = "lensed"
_CODED = (".png", ".jpg", ".jpeg")
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
    for path in picture_files(folder, below=data_set):
        name = picture_name(path)
        if name not in files or _rank(path) < _rank(files[name]):
            files[name] = path

    def read(name: str) -> Tensor:
        path = files[name]
        return _radiance(path, bgr or (stored_bgr and path.suffix.lower() == ".npy"))

    return PictureSet(source, tuple(files), read)


def _rank(path: Path) -> int:
    """Linear files come first."""
    suffix = path.suffix.lower()
    return _CODED.index(suffix) + 1 if suffix in _CODED else 0


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
    tables = [_lensed(path) for path in files]
    names = [name for table in tables for name in table.names(_COLUMN)]
    if not all(names) or len(set(names)) < len(names):
        names = [name for table in tables for name in table.numbers()]
    rows = [(table, row) for table in tables for row in range(len(table))]
    place = dict(zip(names, rows, strict=True))

    def read(name: str) -> Tensor:
        table, row = place[name]
        radiance = _decoded(table.picture(row, _COLUMN), f"{table.path}, {name}")
        return radiance.flip(0) if bgr else radiance

    return PictureSet(source, tuple(names), read)


def _lensed(path: Path) -> ParquetTable:
    table = ParquetTable(path, [_COLUMN])
    if _COLUMN not in table.columns:
        raise FileError(f"{path} has the columns {', '.join(table.columns)}, and none {_COLUMN}")
    return table


def _decoded(content: bytes, where: str) -> Tensor:
    """Radiance of the bytes of a picture."""
    with decoding(Path(where), "a picture"), Image.open(io.BytesIO(content)) as picture:
        check_size((picture.height, picture.width, len(picture.getbands())), 1, where)
        samples = np.asarray(picture if picture.mode in ("L", "I;16") else picture.convert("RGB"))
    return picture_of_samples(samples if samples.ndim == 3 else samples[..., None], where)


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
