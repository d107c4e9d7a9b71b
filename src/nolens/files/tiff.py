"""TIFF: pictures of counts and floats, read and written, with what this program notes of them."""

import json
import logging
import math
import os
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray

from nolens.camera import MOSAICS, Frame
from nolens.documents import parse_json
from nolens.errors import DataError, FileError
from nolens.files.arrays import frame_from_array
from nolens.files.atomic import atomic_write
from nolens.files.input import check_part, check_size, decoding

SOFTWARE = "nolens"
"""Name in the files whose description is a note of ours."""
HEIGHTS_IN_UM = "heights in um"
"""Description of a TIFF that holds a camera's relief."""

_PICTURES = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB)
_RAW = (tifffile.PHOTOMETRIC.CFA, tifffile.PHOTOMETRIC.LINEAR_RAW)
_ALPHA = (tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA)
_CODINGS = (
    tifffile.COMPRESSION.NONE,
    tifffile.COMPRESSION.LZW,
    tifffile.COMPRESSION.ADOBE_DEFLATE,
    tifffile.COMPRESSION.DEFLATE,
    tifffile.COMPRESSION.PACKBITS,
    tifffile.COMPRESSION.LZMA,
    tifffile.COMPRESSION.ZSTD,
)
"""Lossless codings whose decoders stop at the size of a strip."""
_LARGE = 2**28
# Far above what any lossless coding reaches on a picture: more is a damaged header.
_MOST_COMPRESSED = 10_000
_MOST_PAGES = 10_000
"""Directories of one file."""
_MOST_TAGS = 1000
_MOST_BYTES = 2**24
"""Of the values of one tag: places of strips, texts, colour profiles."""
_SIZES = np.array([0, 1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 0, 0, 8, 8, 8], np.uint64)
"""Bytes of a value, by its type."""


def read_tiff(path: Path, page: int | None = None) -> Frame:
    """Read one page of grey or colour, in strips or tiles, interleaved or planar.

    Pages are counted from 0; None is for a file that is to have one.

    Raises
    ------
    FileError
        If the file is damaged or incomplete, has several pages, or holds values or a coding
        that cannot be read.
    """
    samples = read_tiff_samples(path, page)
    values = samples.values[: len(samples.values) - len(samples.alphas)]
    return _apply_note(frame_from_array(values, str(path)), samples.note)


class _Samples(NamedTuple):
    """A page of TIFF: values (channels, height, width), whose last channels are alpha.

    `alphas` says for each of those whether the colours are multiplied by it; `note` is that of
    `own_note`.
    """

    values: NDArray[np.generic]
    alphas: tuple[bool, ...]
    note: dict[str, Any]


def read_tiff_samples(path: Path, number: int | None = None) -> _Samples:
    """Read all channels of a page, alpha included.

    Raises
    ------
    FileError
        As `read_tiff` does, but for the kind of the values.
    """
    check_directories(path)
    with decoding(path, "a TIFF"), open_tiff(path) as tiff:
        page = _page(path, tiff, number)
        _check_kind(path, page)
        _check_complete(path, page)
        # Every worker holds parts of its own beside the picture.
        workers = 1 if page.nbytes > _LARGE else None
        alphas = (extra for extra in page.extrasamples if extra in _ALPHA)
        return _Samples(
            _channels_first(page.asarray(squeeze=False, maxworkers=workers)),
            tuple(extra == tifffile.EXTRASAMPLE.ASSOCALPHA for extra in alphas),
            own_note(page),
        )


def count_pages(path: Path) -> int:
    """Pictures in a TIFF; 1 where it cannot be read, as `read_tiff` says why.

    Raises
    ------
    FileError
        If it has too many to be counted.
    """
    check_directories(path)
    try:
        with open_tiff(path) as tiff:
            return len(_pages(tiff))
    except Exception:  # Damaged tags can raise nearly anything.
        return 1


def _pages(tiff: tifffile.TiffFile) -> list[tifffile.TiffPage]:
    # Counting walks the chain of directories, and raises where damage makes it endless;
    # iterating alone would follow it for ever.
    every = tiff.pages[: len(tiff.pages)]
    return [p for p in every if isinstance(p, tifffile.TiffPage) and not p.is_reduced]


def _page(path: Path, tiff: tifffile.TiffFile, number: int | None) -> tifffile.TiffPage:
    pages = _pages(tiff)
    if not pages:
        raise FileError(f"{path} is a TIFF without a picture in it")
    if number is not None:
        return pages[number]
    count = max(len(pages), pages[0].imagedepth)
    if count == 1 and tiff.is_imagej:
        # ImageJ writes a whole stack behind the directory of its first page.
        count = int((tiff.imagej_metadata or {}).get("images", 1))
    if count > 1:
        raise FileError(
            f"{path} has {count} pages, and which one to take is not said: save the one page (or "
            "the mean of all) as a file of its own"
        )
    return pages[0]


def _check_kind(path: Path, page: tifffile.TiffPage) -> None:
    if page.photometric in _RAW:
        raise FileError(
            f"{path} is camera raw in a TIFF (it is a DNG, or made like one): rename it to "
            f"{path.with_suffix('.dng').name}, so that its mosaic, black and white level are read"
        )
    if page.photometric not in _PICTURES:
        raise FileError(
            f"{path} is a TIFF of kind {_name(page.photometric)}; accepted are grey (MINISBLACK) "
            "and RGB"
        )
    if page.compression not in _CODINGS:
        raise FileError(
            f"{path} is compressed with {_name(page.compression)}, which cannot be read here. "
            "Uncompressed, LZW, Deflate, PackBits, LZMA and ZSTD work: save it again without "
            "compression, for example by: tiffcp -c none in.tif out.tif"
        )
    if page.dtype is None or page.bitspersample != 8 * page.dtype.itemsize:
        raise FileError(
            f"{path} stores {page.bitspersample} bits for a value; accepted are 8 or 16-bit "
            "counts and 16, 32 or 64-bit floats"
        )
    # A tile may be larger than the picture, and is decoded whole.
    for shape in (page.shape, page.chunks):
        check_size(shape, page.dtype.itemsize, path)


def _check_complete(path: Path, page: tifffile.TiffPage) -> None:
    """Refuse missing data, for which tifffile fills in zeros."""
    size = path.stat().st_size
    offsets, lengths = page.dataoffsets, page.databytecounts
    coded = page.compression != tifffile.COMPRESSION.NONE
    parts = 1 if page.is_contiguous else math.prod(page.chunked)
    if (
        min(len(offsets), len(lengths)) < parts
        or 0 in lengths[:parts]
        or any(at + long > size for at, long in zip(offsets, lengths, strict=False))
        or (not coded and sum(lengths) < page.nbytes)
        or page.nbytes > _MOST_COMPRESSED * size
    ):
        raise FileError(
            f"{path} is incomplete: parts of the picture that it announces are not in its "
            f"{size} bytes. Copy it again from where it was made"
        )
    if coded and page.dtype is not None:
        check_part(math.prod(page.chunks) * page.dtype.itemsize, max(lengths[:parts]), path)
    if sum(lengths[:parts]) > size:
        raise FileError(
            f"{path} is damaged: {parts} parts of its picture share the same bytes of the file. "
            "Copy it again from where it was made"
        )


def _channels_first(array: NDArray[np.generic]) -> NDArray[np.generic]:
    """(channels, height, width) of (planes, 1, height, width, samples)."""
    planes, _, height, width, samples = array.shape
    return np.moveaxis(array[:, 0], -1, 1).reshape(planes * samples, height, width)


def _name(value: int) -> str:
    return value.name if hasattr(value, "name") else f"number {value}"


@contextmanager
def open_tiff(path: Path) -> Iterator[tifffile.TiffFile]:
    """Open a file with the library's logger and NumPy's warnings off.

    What the library would say of a file becomes an error of ours.
    """
    logger = logging.getLogger("tifffile")
    before = logger.disabled
    logger.disabled = True
    try:
        with np.errstate(all="ignore"), tifffile.TiffFile(path) as tiff:
            yield tiff
    finally:
        logger.disabled = before


def own_note(page: tifffile.TiffPage) -> dict[str, Any]:
    """What this program noted of a page; nothing for another program's, or a damaged note."""
    if page.software != SOFTWARE:
        return {}
    try:
        note = parse_json(page.description, "the note")
    except DataError:
        return {}
    return note if isinstance(note, dict) else {}


def _apply_note(frame: Frame, note: Mapping[str, Any]) -> Frame:
    """The frame with the levels, the mosaic and the exposure time that a note has."""
    black, white = _noted_number(note.get("black")), _noted_number(note.get("white"))
    if black is None:
        return frame
    frame = replace(
        frame,
        black=(black,),
        black_stated=True,
        white=frame.white if white is None else white,
        exposure_s=_noted_number(note.get("exposure_s")),
        sensor=_noted_size(note.get("sensor")),
    )
    if note.get("mosaic") in MOSAICS and frame.channels == ("grey",):
        frame = replace(frame, channels=("mosaic",), mosaic=note["mosaic"])
    return frame


def _noted_size(value: Any) -> tuple[int, int] | None:
    whole = isinstance(value, list) and all(type(each) is int and each > 0 for each in value)
    return (value[0], value[1]) if whole and len(value) == 2 else None


def _noted_number(value: Any) -> float | None:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return float(value) if is_number and 0 <= value < 2**24 else None


def write_tiff(
    path: str | Path, values: NDArray[Any], note: str | Mapping[str, Any], **options: Any
) -> None:
    """Write values (height, width) or (height, width, 3) as they are, with a note of them.

    Parameters
    ----------
    values
        Counts or floats.
    note
        Becomes the description of the file, a mapping as JSON.
    options
        Of `tifffile.imwrite`, besides.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    with atomic_write(path) as temporary:
        tifffile.imwrite(
            temporary,
            np.ascontiguousarray(values),
            photometric="rgb" if values.ndim == 3 else "minisblack",
            description=note if isinstance(note, str) else json.dumps(note),
            metadata=None,
            software=SOFTWARE,
            **options,
        )


def check_directories(path: Path) -> None:
    """Refuse a TIFF, or a raw file built like one, whose directories alone would fill the memory.

    Where the chain is broken it is left to the reader, which says so.

    Raises
    ------
    FileError
        If there are too many directories, or tags in one, or a tag has too many values.
    """
    with path.open("rb") as file:
        try:
            _walk(path, file)
        except struct.error:  # It ends in the middle of a directory.
            return


def _walk(path: Path, file: BinaryIO) -> None:
    order = "<" if file.read(2) == b"II" else ">"
    (version,) = struct.unpack(f"{order}H", file.read(2))
    big = version == 43
    count, entry, offset = ("Q", 20, "Q") if big else ("H", 12, "I")
    file.seek(8 if big else 4)
    length = os.fstat(file.fileno()).st_size
    visited = set[int]()
    while 0 < (place := _one(file, order + offset)) < length and place not in visited:
        visited.add(place)
        if len(visited) > _MOST_PAGES:
            raise FileError(
                f"{path} has more than {_MOST_PAGES} pages: give a folder of files, or an .npy"
            )
        file.seek(place)
        tags = _one(file, order + count)
        if tags > _MOST_TAGS:
            raise _damaged(path, f"a page with {tags} tags")
        data = file.read(tags * entry)
        if len(data) < tags * entry:
            return
        fields = np.frombuffer(
            data,
            [
                ("code", f"{order}u2"),
                ("type", f"{order}u2"),
                ("count", f"{order}u{8 if big else 4}"),
                ("value", f"V{8 if big else 4}"),
            ],
        )
        sizes = _SIZES[np.minimum(fields["type"], len(_SIZES) - 1)].astype(np.float64)
        lengths = sizes * fields["count"]
        if lengths.size and lengths.max() > _MOST_BYTES:
            tag = fields[int(lengths.argmax())]
            raise _damaged(path, f"{int(tag['count'])} values of its tag {int(tag['code'])}")


def _one(file: BinaryIO, form: str) -> int:
    (value,) = struct.unpack(form, file.read(struct.calcsize(form)))
    return int(value)


def _damaged(path: Path, what: str) -> FileError:
    return FileError(
        f"{path} cannot be read as a TIFF: its directory announces {what}, more than any picture "
        "has. Copy it again from where it was made"
    )
