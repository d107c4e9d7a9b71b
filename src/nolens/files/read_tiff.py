"""TIFF pictures: counts of 8 and 16 bits, and floats."""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
import tifffile
from numpy.typing import NDArray

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array
from nolens.files.damage import damage
from nolens.files.limits import check_part, check_size
from nolens.files.quiet import quiet_library
from nolens.files.tiff_directories import check_directories
from nolens.files.tiff_note import TiffNote

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


def read_tiff(path: Path, page: int | None = None) -> Frame:
    """Read one page of grey or colour, in strips or tiles, interleaved or planar.

    Parameters
    ----------
    path
        The file.
    page
        Which of several, from 0; None where there is to be one.

    Raises
    ------
    FileError
        If the file is damaged or incomplete, has several pages, or holds values or a coding
        that cannot be read.
    """
    found = read_tiff_samples(path, page)
    values = found.values[: len(found.values) - len(found.alphas)]
    return found.note.applied(frame_from_array(values, str(path)))


class TiffSamples(NamedTuple):
    """What a page of TIFF holds.

    Parameters
    ----------
    values
        (channels, height, width), whose last ones are alpha.
    alphas
        For each channel of alpha, whether the colours are multiplied by it.
    note
        What this program wrote about its own files.
    """

    values: NDArray[np.generic]
    alphas: tuple[bool, ...]
    note: TiffNote


def read_tiff_samples(path: Path, number: int | None = None) -> TiffSamples:
    """Read all channels of a page, alpha included.

    Raises
    ------
    FileError
        As `read_tiff` does, but for the kind of the values.
    """
    check_directories(path)
    try:
        with quiet_library("tifffile"), tifffile.TiffFile(path) as tiff:
            page = _page(path, tiff, number)
            _check_kind(path, page)
            _check_complete(path, page)
            # Every worker holds parts of its own beside the picture.
            workers = 1 if page.nbytes > _LARGE else None
            return TiffSamples(
                _channels_first(page.asarray(squeeze=False, maxworkers=workers)),
                tuple(
                    extra == tifffile.EXTRASAMPLE.ASSOCALPHA
                    for extra in page.extrasamples
                    if extra in _ALPHA
                ),
                TiffNote.of(page),
            )
    except FileError:
        raise
    # Damaged tags can raise nearly anything, MemoryError and struct.error included.
    except Exception as error:
        raise damage(path, "a TIFF", error) from error


def count_pages(path: Path) -> int:
    """Pictures in a TIFF; 1 where it cannot be read, as `read_tiff` says why.

    Raises
    ------
    FileError
        If it has too many to be counted.
    """
    check_directories(path)
    try:
        with quiet_library("tifffile"), tifffile.TiffFile(path) as tiff:
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
