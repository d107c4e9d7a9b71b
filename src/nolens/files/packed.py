"""Bare data of a sensor: counts of 8 to 16 bits without a header, packed or not (.raw, .bin)."""

import math
import re
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nolens.camera import Frame
from nolens.camera.part import Part, refusal
from nolens.camera.toml import from_toml
from nolens.errors import FileError, OptionError
from nolens.files.arrays import frame_from_array
from nolens.files.formats import FrameSequence, numbered, refuse_dataset
from nolens.files.input import DESCRIBE_BARE, check_size, read_text, system_errors
from nolens.files.raw import open_raw
from nolens.quantities import Duration
from nolens.ranges import Between

_BESIDE = "raw.toml"
"""Description of all bare files of a folder that have none of their own name."""
_GENICAM = re.compile(r"(?:Mono|Bayer(RG|BG|GR|GB))(8|10|12|14|16)(p|Packed)?")
_LINUX = re.compile(r"(?:S(RGGB|BGGR|GRBG|GBRG)|R|Y)(8|10|12|14|16)(_CSI2P|P)?")
_MOSAICS = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}
_FILLED = 256
"""Bytes that a row of a single frame may be filled up with."""
_ACCEPTED = (
    "accepted are names of GenICam such as Mono12, BayerRG12p and Mono10Packed, and of libcamera "
    "and Linux such as SRGGB10_CSI2P, SRGGB12_CSI2P, R10_CSI2P and SRGGB16"
)


@dataclass(frozen=True)
class PixelFormat:
    """How the counts of a sensor lie in bytes.

    Attributes
    ----------
    bits
        Of a count.
    mosaic
        Colours of the 2×2 superpixel; None for grey, or where it is not known.
    packing
        None for whole bytes, the lowest first; ``"p"`` and ``"Packed"`` of GenICam (Pixel Format
        Naming Convention 2.4, 5.2), ``"CSI2P"`` of MIPI (CSI-2 1.3, 11.4; V4L2_PIX_FMT_SRGGB10P).
    """

    bits: int
    mosaic: str | None
    packing: str | None

    @classmethod
    def of(cls, name: str) -> "PixelFormat":
        """Read a name of GenICam's or libcamera's.

        Raises
        ------
        OptionError
            If it is none of those.
        """
        genicam, linux = _GENICAM.fullmatch(name), _LINUX.fullmatch(name)
        if genicam is not None:
            made = cls(int(genicam[2]), _MOSAICS.get(genicam[1] or ""), genicam[3])
        elif linux is not None:
            made = cls(int(linux[2]), linux[1], "CSI2P" if linux[3] else None)
        else:
            raise OptionError(f"{name!r} is no format of pixels that is known: {_ACCEPTED}")
        whole = made.bits in (8, 16)
        if made.packing and (whole or (made.packing == "Packed" and made.bits not in (10, 12))):
            raise OptionError(f"{name!r}: {made.bits} bits are not packed like that; {_ACCEPTED}")
        return made

    @property
    def white(self) -> float:
        """The largest count."""
        return 2.0**self.bits - 1

    @property
    def group(self) -> tuple[int, int]:
        """Pixels that are packed together, and their bytes."""
        if self.packing is None:
            return 1, 1 if self.bits == 8 else 2
        if self.packing == "Packed":
            return 2, 3
        pixels = 8 // math.gcd(8, self.bits)
        return pixels, pixels * self.bits // 8

    def row_bytes(self, width: int) -> int:
        """Bytes of a row that is filled up to whole groups."""
        pixels, size = self.group
        return -(-width // pixels) * size

    def unpack(self, data: NDArray[np.uint8], width: int) -> NDArray[np.uint16]:
        """Counts (height, width) of rows of bytes, which may be longer than `row_bytes`."""
        pixels, size = self.group
        rows = data[:, : self.row_bytes(width)]
        groups = rows.reshape(len(rows), -1, size).astype(np.uint64)
        if self.packing in (None, "p"):
            word, first = _word(groups), self.bits * np.arange(pixels, dtype=np.uint64)
            counts = (word[..., None] >> first) & np.uint64(2**self.bits - 1)
        else:
            # The upper eight bits of every pixel are a byte; those below are together.
            upper = groups[..., [0, 2]] if self.packing == "Packed" else groups[..., :pixels]
            rest = groups[..., [1]] if self.packing == "Packed" else groups[..., pixels:]
            lower = np.uint64(self.bits - 8)
            step = np.uint64(4) if self.packing == "Packed" else lower
            first = step * np.arange(pixels, dtype=np.uint64)
            below = (_word(rest)[..., None] >> first) & np.uint64(2 ** int(lower) - 1)
            counts = (upper << lower) | below
        return counts.reshape(len(rows), -1)[:, :width].astype(np.uint16)


def _word(groups: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """One number of the bytes of every group, the lowest first."""
    places = np.uint64(8) * np.arange(groups.shape[-1], dtype=np.uint64)
    word: NDArray[np.uint64] = np.bitwise_or.reduce(groups << places, axis=-1)
    return word


class BareFrames(Part):
    """What a .toml beside bare data says of it.

    Attributes
    ----------
    width, height
        Of a frame, in pixels.
    format
        Name of the format of its pixels, for `PixelFormat`.
    stride
        Bytes from row to row; None where rows follow one another, or the file has one frame.
    offset
        Bytes before the first frame.
    black, white
        Count that stands for no light, and count from which a pixel is saturated.
    exposure
        Exposure time.
    """

    width: Annotated[int, Between(1, 100_000)]
    height: Annotated[int, Between(1, 100_000)]
    format: Annotated[str, Field(max_length=40)]
    stride: Annotated[int, Between(1, 10**6)] | None = None
    offset: Annotated[int, Between(0, 10**9)] = 0
    black: Annotated[float, Between(0, 65535)] | None = None
    white: Annotated[float, Between(1, 65535)] | None = None
    exposure: Annotated[Duration, Between("1 us", "1e6 s")] | None = None

    @property
    def pixels(self) -> PixelFormat:
        """The format of the pixels."""
        return PixelFormat.of(self.format)

    def model_post_init(self, _: object) -> None:
        """Refuse a format that is not known, and a stride that is too short."""
        try:
            least = self.pixels.row_bytes(self.width)
        except OptionError as error:
            raise refusal(str(error)) from None
        if self.stride is not None and self.stride < least:
            raise refusal(f"a row of {self.width} pixels has {least} bytes: stride is less")


def open_bare(path: Path, dataset: str | None) -> FrameSequence:
    """Open bare data that a .toml of the same name, or raw.toml in its folder, describes.

    A .raw without one may be camera raw.

    Raises
    ------
    FileError
        If its bytes are no whole number of frames.
    DataError
        If the description cannot be used.
    """
    beside = next(
        (each for each in (path.with_suffix(".toml"), path.with_name(_BESIDE)) if each.is_file()),
        None,
    )
    if beside is None:
        if path.suffix.lower() == ".raw":
            return open_raw(path, dataset)
        raise FileError(f"{path} has no header, and nothing says what it holds: {DESCRIBE_BARE}")
    refuse_dataset(path, dataset)
    about = from_toml(BareFrames, read_text(beside), str(beside))
    check_size((about.height, about.width), 2, path)
    with system_errors(path):
        there = path.stat().st_size - about.offset
    stride = about.stride or about.pixels.row_bytes(about.width)
    one = there // about.height
    if about.stride is None and stride < one < stride + _FILLED and there == one * about.height:
        stride = one
    if there <= 0 or there % (stride * about.height):
        raise FileError(
            f"{path} has {there} bytes after {about.offset}, which are no whole frames of "
            f"{about.height} rows of {stride} bytes ({about.format}, {about.width} pixels): mend "
            f"width, height, format, offset or stride in {beside}"
        )
    count = there // (stride * about.height)
    names = (path.stem,) if count == 1 else numbered(count)
    return FrameSequence(names, (path,), partial(_read, path, about, stride, count))


def _read(path: Path, about: BareFrames, stride: int, count: int, number: int) -> Frame:
    size = stride * about.height
    with system_errors(path), path.open("rb") as file:
        file.seek(about.offset + number * size)
        data = np.frombuffer(file.read(size), np.uint8)
    if len(data) < size:
        raise FileError(f"{path} has become shorter: copy it again from where it was made")
    pixels = about.pixels
    counts = pixels.unpack(data.reshape(about.height, stride), about.width)
    frame = frame_from_array(counts[None], str(path) if count == 1 else f"{path}#{number + 1}")
    return replace(
        frame,
        channels=("grey",) if pixels.mosaic is None else ("mosaic",),
        mosaic=pixels.mosaic,
        black=(about.black or 0.0,),
        black_stated=about.black is not None,
        white=about.white or pixels.white,
        exposure_s=None if about.exposure is None else about.exposure.s,
    )
