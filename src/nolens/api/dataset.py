"""Data sets of `nolens dataset make`, item by item, as PyTorch takes them."""

from pathlib import Path
from typing import Any, Literal

import torch
from torch import Tensor
from torch.utils.data import Dataset

from nolens.api.simulate import Psf
from nolens.camera import Frame
from nolens.errors import DataError, OptionError
from nolens.files import read_frame
from nolens.files.dataset import Shard, decode_picture, open_shard, read_dataset
from nolens.operators import PixelRectangle

Split = Literal["train", "validation", "test"]


class LenslessDataset(Dataset[dict[str, Any]]):
    """Measurements and truths of a folder that `nolens dataset make` wrote.

    ``dataset[i]`` has ``measurement`` and ``truth``, float32, (channels, height, width), and the
    other columns of the card. Measurements are counts (raw) or counts above black (developed), and
    the truth is linear radiance, 1 is white. Shards are opened when they are needed, in each worker
    of a `DataLoader` again.

    Parameters
    ----------
    folder
        With ``dataset.json``.
    split
        ``"train"``, ``"validation"`` or ``"test"``.

    Raises
    ------
    FileError
        If the folder holds no finished data set.
    OptionError
        If it has no such split, or the library for its layout is not installed.
    """

    def __init__(self, folder: str | Path, split: Split = "train") -> None:
        self.folder = Path(folder)
        self.description = read_dataset(self.folder)
        if split not in self.description.splits:
            raise OptionError(
                f"there is no split {split!r}; there are {', '.join(self.description.splits)}"
            )
        self._shards = self.description.splits[split].shards
        self._places = [
            (shard.file, place) for shard in self._shards for place in range(shard.items)
        ]
        self._psfs: dict[str, Psf] = {}
        self._open: tuple[str, Shard] | None = None

    def __len__(self) -> int:
        return len(self._places)

    def __getitem__(self, number: int) -> dict[str, Any]:
        """The item of a place in the split."""
        row = self._row(number)
        source = self.folder / self._places[number][0]
        for name in ("measurement", "truth"):
            values = torch.from_numpy(decode_picture(row[name], source))
            row[name] = values * row[f"{name}_scale"] + row.get(f"{name}_offset", 0.0)
        return row

    def frame(self, number: int) -> Frame:
        """The measurement as a raw frame, for `nolens.reconstruct` and `nolens.develop`.

        Raises
        ------
        DataError
            If the data set has developed measurements.
        """
        if self.description.measurement != "raw":
            raise DataError(
                f"{self.folder} has developed measurements, and no raw frames: make it with "
                "--measurement raw"
            )
        row = self[number]
        mosaic = self.description.psfs[row["psf"]].mosaic
        return Frame(
            row["measurement"],
            ("grey",) if mosaic is None else ("mosaic",),
            mosaic,
            (row["black_counts"],),
            row["white_counts"],
            "uint16",
            f"item {row['index']} of {self.folder}",
            row["exposure_s"],
            black_stated=True,
        )

    def psf(self, name: str) -> Psf:
        """The PSF of a name, as items have it; read once."""
        if name not in self._psfs:
            frame = read_frame(self.folder / self._psf(name).file)
            self._psfs[name] = Psf(frame.counts, frame.channels)
        return self._psfs[name]

    def response(self, name: str) -> Tensor:
        """How much light of each scene pixel reaches the sensor, (1, height, width)."""
        return read_frame(self.folder / self._psf(name).response).counts

    def support(self, name: str) -> PixelRectangle:
        """Pixels of the truth in the sensor's frame, for cameras of a PSF."""
        height, width, top, left = self._psf(name).support
        return PixelRectangle(top, left, height, width)

    def _psf(self, name: str) -> Any:
        psfs = self.description.psfs
        if name not in psfs:
            raise OptionError(f"there is no PSF {name!r}; there are {', '.join(psfs)}")
        return psfs[name]

    def _row(self, number: int) -> dict[str, Any]:
        file, place = self._places[number]
        if self._open is None or self._open[0] != file:
            self._open = file, open_shard(self.folder / file)
        return self._open[1][place]

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_open": None}  # Each process opens its own.

    def __repr__(self) -> str:
        return f"LenslessDataset({str(self.folder)!r}, {len(self)} items)"
