"""TIFF: pictures of counts and floats, read and written, with what this program notes of them."""

import json
import logging
import math
import os
import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, cast

import numpy as np
import tifffile
from numpy.typing import NDArray

from nolens.camera import MOSAICS, Frame
from nolens.documents import parse_json
from nolens.errors import DataError, FileError
from nolens.files.arrays import frame_from_array, frames_of_array
from nolens.files.atomic import atomic_write
from nolens.files.axes import Part
from nolens.files.formats import FrameSequence, numbered, refuse_dataset, several_frames
from nolens.files.input import check_part, check_size, decoding

SOFTWARE = "nolens"
"""Name in the files whose description is a note of ours."""
HEIGHTS_IN_UM = "heights in um"
"""Description of a TIFF that holds a camera's relief."""

_PICTURES = (tifffile.PHOTOMETRIC.MINISBLACK, tifffile.PHOTOMETRIC.RGB)
_RAW = (tifffile.PHOTOMETRIC.CFA, tifffile.PHOTOMETRIC.LINEAR_RAW)
_ALPHA = (tifffile.EXTRASAMPLE.ASSOCALPHA, tifffile.EXTRASAMPLE.UNASSALPHA)
_JPEG2000 = (tifffile.COMPRESSION.JPEG2000, tifffile.COMPRESSION.JPEG_2000_LOSSY)
_CODINGS = (
    tifffile.COMPRESSION.NONE,
    tifffile.COMPRESSION.LZW,
    tifffile.COMPRESSION.ADOBE_DEFLATE,
    tifffile.COMPRESSION.DEFLATE,
    tifffile.COMPRESSION.PACKBITS,
    tifffile.COMPRESSION.LZMA,
    tifffile.COMPRESSION.ZSTD,
    *_JPEG2000,
)
"""Codings that keep values proportional to light, and whose decoders stop at the size of a strip;
that of JPEG-2000 is checked before."""
_JPEG2000_HEAD = 4096
"""Bytes in which its first segment begins."""
_IMAGEJ_AXES = ("frames", "slices", "channels")
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


def open_tiff_frames(path: Path, dataset: str | None) -> FrameSequence:
    """Open grey or colour, in strips or tiles, interleaved or planar, of one page or many.

    Every page is a frame, or a channel of one where OME-TIFF's or ImageJ's metadata say so.

    Raises
    ------
    FileError
        If the file has too many pages.
    """
    refuse_dataset(path, dataset)
    check_directories(path)
    try:
        with open_tiff(path) as tiff:
            behind = _behind_first_page(path, tiff)
            frames = [] if behind is not None else _frames_of_pages(path, tiff)
    except FileError:
        raise
    except Exception:  # Damaged tags can raise nearly anything; reading says what is wrong.
        behind, frames = None, [(0,)]
    if behind is not None:
        return behind
    return FrameSequence(numbered(len(frames)), (path,), partial(_read_frame, path, frames))


def _read_frame(path: Path, frames: Sequence[tuple[int, ...]], number: int) -> Frame:
    samples = [read_tiff_samples(path, each) for each in frames[number]]
    values = [each.values[: len(each.values) - len(each.alphas)] for each in samples]
    sizes = sorted({each.shape[1:] for each in values})
    if len(sizes) > 1:
        given = " and ".join(f"{height}×{width}" for height, width in sizes)
        raise FileError(
            f"{path} says that several of its pages are channels of one frame, and these have "
            f"{given} pixels: they need one size. Copy it again from where it was made"
        )
    source = str(path) if len(frames) == 1 else f"{path}#{number + 1}"
    frame = frame_from_array(values[0] if len(values) == 1 else np.concatenate(values), source)
    if frame.white is not None:
        frame = replace(frame, white=2.0 ** samples[0].bits - 1)
    return _apply_note(frame, samples[0].note)


class _Samples(NamedTuple):
    """A page of TIFF: values (channels, height, width), whose last channels are alpha.

    `alphas` says for each of those whether the colours are multiplied by it; `note` is that of
    `own_note`. `bits` of a value are stored.
    """

    values: NDArray[np.generic]
    alphas: tuple[bool, ...]
    note: dict[str, Any]
    bits: int


def read_tiff_samples(path: Path, number: int | None = None) -> _Samples:
    """Read all channels of a page, alpha included; None is for a file that is to have one.

    Raises
    ------
    FileError
        If the file is damaged or incomplete, has several pages where it is to have one, or holds
        a coding that cannot be read.
    """
    if number is None:
        frames = open_tiff_frames(path, None)
        if len(frames) != 1:
            raise several_frames(path, len(frames))
        number = 0
    with decoding(path, "a TIFF"), open_tiff(path) as tiff:
        page = cast(tifffile.TiffPage, tiff.pages[number])
        _check_complete(path, page, _check_kind(path, page).itemsize)
        # Every worker holds parts of its own beside the picture.
        workers = 1 if page.nbytes > _LARGE else None
        alphas = (extra for extra in page.extrasamples if extra in _ALPHA)
        return _Samples(
            _channels_first(page.asarray(squeeze=False, maxworkers=workers)),
            tuple(extra == tifffile.EXTRASAMPLE.ASSOCALPHA for extra in alphas),
            own_note(page),
            page.bitspersample,
        )


def _frames_of_pages(path: Path, tiff: tifffile.TiffFile) -> list[tuple[int, ...]]:
    """Numbers of the pages of every frame: one, or one for each channel."""
    # Counting walks the chain of directories, and raises where damage makes it endless;
    # iterating alone would follow it for ever.
    pages = tiff.pages[: len(tiff.pages)]
    description = pages[0].description if isinstance(pages[0], tifffile.TiffPage) else ""
    if tiff.is_imagej:
        # Channels of other numbers are what programs call frames that they know nothing of.
        sizes = _imagej_sizes(description)
        if sizes["C"] == 3 and math.prod(sizes.values()) == len(pages):
            return _by_channels(list(range(len(pages))), "TZC", sizes)
    elif tiff.is_ome:
        return _ome_frames(path, description, pages)
    return [
        (number,)
        for number, page in enumerate(pages)
        if isinstance(page, tifffile.TiffPage) and not page.is_reduced
    ]


def _imagej_sizes(description: str) -> dict[str, int]:
    """Lengths of the axes T, Z and C that ImageJ notes of a stack."""
    noted = dict(re.findall(r"^(frames|slices|channels|images)=(\d{1,9})$", description, re.M))
    return {axis: int(noted.get(name, 1)) for axis, name in zip("TZC", _IMAGEJ_AXES, strict=True)}


def _behind_first_page(path: Path, tiff: tifffile.TiffFile) -> FrameSequence | None:
    """Frames of a stack that ImageJ wrote behind the directory of its first page, where that is so.

    It does for more than 4 GB.
    """
    page = tiff.pages.first
    found = re.search(r"^images=(\d{1,9})$", page.description, re.M) if tiff.is_imagej else None
    count = int(found[1]) if found is not None else 1
    if count == 1 or len(tiff.pages) > 1:
        return None
    stored = _check_kind(path, page).newbyteorder(tiff.byteorder)
    if count * page.nbytes > path.stat().st_size - page.dataoffsets[0] or not page.is_contiguous:
        raise FileError(
            f"{path} is incomplete: it announces {count} pages, which are not in its bytes. Copy "
            "it again from where it was made"
        )
    shape = (count, *page.shape)
    take = partial(_part_of_map, path, shape, stored, page.dataoffsets[0])
    return frames_of_array(path, shape, stored, take, axes="T" + page.axes)


def _part_of_map(
    path: Path, shape: tuple[int, ...], stored: np.dtype[Any], offset: int, part: Part
) -> NDArray[Any]:
    return np.memmap(path, stored, "r", offset, shape)[part]


def _ome_frames(path: Path, description: str, pages: Sequence[Any]) -> list[tuple[int, ...]]:
    """Frames by the axes of OME-TIFF: those of one time after another, each from its first depth.

    Three channels are colours; of another number, such as bands, each is a frame.

    https://docs.openmicroscopy.org/ome-model/latest/ome-tiff/specification.html
    """
    pixels = _attributes(description, "Pixels")[0]
    order = pixels["DimensionOrder"][:1:-1]
    sizes = {axis: int(pixels[f"Size{axis}"]) for axis in "TZC"}
    # Colours that are stored together are one plane.
    sizes["C"] = max(1, sizes["C"] // pages[0].samplesperpixel)
    lengths = [sizes[axis] for axis in order]
    count = math.prod(lengths)
    if sorted(order) != ["C", "T", "Z"] or not 0 < count <= _MOST_PAGES:
        raise FileError(
            f"{path} is an OME-TIFF of {sizes['T']} times, {sizes['Z']} depths and {sizes['C']} "
            f"channels; accepted are 1 to {_MOST_PAGES} planes in all"
        )
    planes: list[int | None] = [None] * count
    for block in _attributes(description, "TiffData") or [{}]:
        first = int(
            np.ravel_multi_index([int(block.get(f"First{axis}", 0)) for axis in order], lengths)
        )
        long = int(block.get("PlaneCount", 1 if "IFD" in block else count - first))
        page = int(block.get("IFD", 0))
        for step in range(min(long, count - first, len(pages) - page)):
            planes[first + step] = page + step
    found = [each for each in planes if each is not None]
    if len(found) < count:
        raise FileError(
            f"{path} is an OME-TIFF of {count} planes, of which {len(found)} are in it: the others "
            "are in files beside it. Save all in one file, or as a folder of frames"
        )
    return _by_channels(found, order, sizes)


def ome_channels(path: Path) -> list[str]:
    """Names of the channels of an OME-TIFF.

    Raises
    ------
    FileError
        If the file is damaged.
    """
    with decoding(path, "a TIFF"), open_tiff(path) as tiff:
        channels = _attributes(tiff.pages.first.description, "Channel")
        return [each.get("Name", "") for each in channels]


def _attributes(description: str, element: str) -> list[dict[str, str]]:
    """Attributes of the elements of a name in OME's XML, in their order."""
    starts = re.findall(rf"<(?:\w+:)?{element}\b([^>]*)>", description)
    return [dict(re.findall(r'(\w+)="([^"]*)"', each)) for each in starts]


def _by_channels(planes: list[int], order: str, sizes: Mapping[str, int]) -> list[tuple[int, ...]]:
    """Pages of each frame, of planes in an order of T, Z and C whose last axis runs fastest."""
    grid = np.array(planes).reshape([sizes[axis] for axis in order])
    colours = 3 if sizes["C"] == 3 else 1
    frames = grid.transpose([order.index(axis) for axis in "TZC"]).reshape(-1, colours)
    return [tuple(each) for each in frames.tolist()]


def _check_kind(path: Path, page: tifffile.TiffPage) -> np.dtype[Any]:
    """Refuse what cannot be read; the type of what can."""
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
            "Uncompressed, LZW, Deflate, PackBits, LZMA, ZSTD and JPEG-2000 work: save it again "
            "without compression, for example by: tiffcp -c none in.tif out.tif"
        )
    packed = page.dtype == np.uint16 and 8 < page.bitspersample < 16
    if page.dtype is None or (page.bitspersample != 8 * page.dtype.itemsize and not packed):
        raise FileError(
            f"{path} stores {page.bitspersample} bits for a value; accepted are counts of 8 to 16 "
            "bits and floats of 16, 32 or 64"
        )
    # A tile may be larger than the picture, and is decoded whole.
    for shape in (page.shape, page.chunks):
        check_size(shape, page.dtype.itemsize, path)
    if page.compression in _JPEG2000:
        _check_jpeg2000(path, page)
    return page.dtype


def _check_jpeg2000(path: Path, page: tifffile.TiffPage) -> None:
    """Refuse codestreams that announce more than their strip or tile: they are decoded whole.

    ITU-T T.800, A.5.1: the segment SIZ.
    """
    with path.open("rb") as file:
        for offset, length in zip(page.dataoffsets, page.databytecounts, strict=True):
            file.seek(offset)
            head = file.read(min(length, _JPEG2000_HEAD))
            at = head.find(b"\xff\x4f\xff\x51") + 8
            width, height = struct.unpack(">2I", head[at : at + 8])
            (channels,) = struct.unpack(">H", head[at + 32 : at + 34])
            if at < 8 or width * height * channels > math.prod(page.chunks):
                raise FileError(
                    f"{path} is damaged: a strip or tile says that it has "
                    f"{height}×{width}×{channels} values. Copy it again from where it was made"
                )


def _check_complete(path: Path, page: tifffile.TiffPage, itemsize: int) -> None:
    """Refuse missing data, for which tifffile fills in zeros."""
    size = path.stat().st_size
    offsets, lengths = page.dataoffsets, page.databytecounts
    coded = page.compression != tifffile.COMPRESSION.NONE
    parts = 1 if page.is_contiguous else math.prod(page.chunked)
    if (
        min(len(offsets), len(lengths)) < parts
        or 0 in lengths[:parts]
        or any(at + long > size for at, long in zip(offsets, lengths, strict=False))
        or (not coded and sum(lengths) < page.nbytes * page.bitspersample // 8 // itemsize)
        or page.nbytes > _MOST_COMPRESSED * size
    ):
        raise FileError(
            f"{path} is incomplete: parts of the picture that it announces are not in its "
            f"{size} bytes. Copy it again from where it was made"
        )
    if coded:
        check_part(math.prod(page.chunks) * itemsize, max(lengths[:parts]), path)
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
    if black is None and "mosaic" not in note:
        return frame
    frame = replace(
        frame,
        black=(black or 0.0,),
        black_stated=black is not None,
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
