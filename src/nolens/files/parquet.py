"""Parquet: tables with columns of pictures, such as those of Hugging Face."""

from collections import Counter
from functools import lru_cache, partial
from itertools import accumulate
from pathlib import Path
from types import ModuleType
from typing import Any

from nolens.camera import Frame
from nolens.errors import FileError, OptionError
from nolens.files.arrays import decode_png, frame_of_samples
from nolens.files.formats import FrameSequence, picture_name
from nolens.files.input import check_size, decoding, system_errors

_JPEG = b"\xff\xd8\xff"
_BYTES = ("binary", "large_binary")


class ParquetTable:
    """Rows of a Parquet file; those of one row group at a time are held.

    Parameters
    ----------
    path
        The file.
    columns
        That are read; None takes all.

    Raises
    ------
    FileError
        If the file is missing or damaged.
    OptionError
        If pyarrow is missing.
    """

    def __init__(self, path: Path, columns: list[str] | None = None) -> None:
        self.path, self._columns = path, columns
        library = _library(path)
        with system_errors(path), decoding(path, "Parquet"):
            self._file = library.ParquetFile(path, memory_map=True)
            about = self._file.metadata
            counts = [about.row_group(number).num_rows for number in range(about.num_row_groups)]
        self._ends = [*accumulate(counts)]
        self._group: tuple[int, Any] = -1, None

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    @property
    def columns(self) -> list[str]:
        """Names of all columns."""
        names: list[str] = self._file.schema_arrow.names
        return names

    @property
    def picture_columns(self) -> list[str]:
        """Those that hold the bytes of pictures, or these and the names of their files."""
        return [each for each in self.columns if self._parts(each).get("bytes") in _BYTES]

    def _parts(self, column: str) -> dict[str, str]:
        """Types of the parts of a column's cells; bytes alone are one part."""
        kind = self._file.schema_arrow.field(column).type
        parts = kind if hasattr(kind, "fields") else ()
        return {each.name: str(each.type) for each in parts} or {"bytes": str(kind)}

    def __getitem__(self, place: int) -> dict[str, Any]:
        number = next(at for at, end in enumerate(self._ends) if place < end)
        if self._group[0] != number:
            size = self._file.metadata.row_group(number).total_byte_size
            check_size((size,), 1, f"row group {number} of {self.path}")
            with decoding(self.path, "Parquet"):
                self._group = number, self._file.read_row_group(number, columns=self._columns)
        rows = self._group[1]
        row: dict[str, Any] = rows.slice(place - self._ends[number] + len(rows), 1).to_pylist()[0]
        return row

    def picture(self, place: int, column: str) -> bytes:
        """Bytes of a picture.

        Raises
        ------
        FileError
            If there are none.
        """
        content = self[place][column]
        if isinstance(content, dict):
            content = content.get("bytes")
        if not isinstance(content, bytes) or not content:
            raise FileError(
                f"{self.path}, row {place}, has no bytes in its column {column}: save it with its "
                "pictures"
            )
        return content

    def names(self, column: str) -> list[str]:
        """Names of pictures by their files; empty where they have none."""
        if "path" not in self._parts(column):
            return [""] * len(self)
        with decoding(self.path, "Parquet"):
            cells = self._file.read(columns=[f"{column}.path"]).column(column).to_pylist()
        return [picture_name(Path((each or {}).get("path") or "")) for each in cells]

    def numbers(self) -> list[str]:
        """Names of rows by split and number, such as train-00012, those of earlier shards before.

        Shards are called SPLIT-00000-of-00003.parquet.
        """
        split = self.path.name.partition("-")[0].removesuffix(".parquet")
        beside = sorted(self.path.parent.glob(f"{split}-*.parquet"))
        read = _library(self.path).read_metadata
        with decoding(self.path, "Parquet"):
            first = sum(read(each).num_rows for each in beside if each.name < self.path.name)
        return [f"{split}-{first + row:05}" for row in range(len(self))]


def open_parquet(path: Path, dataset: str | None) -> FrameSequence:
    """Open a column of pictures, PNG of 8 or 16 bits: one frame a row.

    Raises
    ------
    FileError
        If the file is damaged, or it is not clear which column is meant.
    OptionError
        If pyarrow is missing.
    """
    table = ParquetTable(path)
    there = table.picture_columns
    column = there[0] if dataset is None and len(there) == 1 else dataset
    if column not in there:
        asked = "" if dataset is None else f"no pictures in a column {dataset!r}; "
        raise FileError(
            f"{path} has {asked}columns of pictures: {', '.join(there) or 'none'}"
            + (f". Name the one, such as {path}:/{there[0]}" if there else "")
        )
    names = table.names(column)
    if not all(names) or max(Counter(names).values(), default=0) > 1:
        names = table.numbers()
    read = partial(_read, path, path.stat().st_mtime_ns, column)
    return FrameSequence(tuple(names), (path,), read)


def _read(path: Path, changed: int, column: str, number: int) -> Frame:
    source = f"{path}:/{column}#{number + 1}"
    data = _table(path, changed, column).picture(number, column)
    if data.startswith(_JPEG):
        raise FileError(f"{source} is a JPEG, whose values are not proportional to light")
    return frame_of_samples(decode_png(data, Path(source)), source)


@lru_cache(maxsize=1)
def _table(path: Path, changed: int, column: str) -> ParquetTable:
    return ParquetTable(path, [column])


def _library(path: Path) -> ModuleType:
    try:
        from pyarrow import parquet
    except ImportError:
        raise OptionError(
            f"{path} is a Parquet file, which pyarrow reads: pip install 'nolens[parquet]'"
        ) from None
    module: ModuleType = parquet
    return module
