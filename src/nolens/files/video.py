"""Video (PyAV): frames without loss, or whose curve is stated; and MP4 files of pictures."""

import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from nolens.camera import Frame, linear_from_srgb
from nolens.camera.part import Part
from nolens.camera.toml import from_toml
from nolens.errors import FileError
from nolens.files.arrays import frame_from_array
from nolens.files.atomic import atomic_write
from nolens.files.formats import FrameSequence, numbered, refuse_dataset
from nolens.files.input import check_size, decoding, read_text
from nolens.files.pictures import screen_picture

_DEMUXERS = {".mkv": "matroska", ".avi": "avi", ".mov": "mov", ".mp4": "mov"}
_LOSSLESS = ("ffv1", "rawvideo", "huffyuv", "ffvhuff", "utvideo", "magicyuv", "png", "tiff")
_BAYER = re.compile(r"bayer_([rgb]{4})(?:8|16le)")
_PLAIN = re.compile(r"(?:gray(?:\d+le)?|rgb24|rgb48le|gbrp(?:\d+le)?)")
_REVERSED = {"bgr24": 3, "bgr0": 4, "bgra": 4}
"""Formats of B, G, R in bytes, and how many bytes a pixel has."""
_MP4_ROWS = 480
"""About the rows of a video to which small pictures are enlarged."""
_RECORD = (
    "record without loss, for example by ffmpeg -c:v ffv1 -pix_fmt gray16le (or gbrp12le) take.mkv"
)


class VideoCurve(Part):
    """What a .toml beside a video says of its values.

    Attributes
    ----------
    curve
        ``"linear"``: proportional to light; ``"srgb"``: by the curve of sRGB, which is undone.
    """

    curve: Literal["linear", "srgb"]


def open_video(path: Path, dataset: str | None) -> FrameSequence:
    """Open a video without loss; of others, a .toml beside it must say the curve.

    Raises
    ------
    FileError
        If the extra is not installed, or the file is damaged, has no video, or has lost something.
    DataError
        If the .toml cannot be used.
    """
    refuse_dataset(path, dataset)
    beside = path.with_suffix(".toml")
    about = from_toml(VideoCurve, read_text(beside), str(beside)) if beside.is_file() else None
    changed = path.stat().st_mtime_ns
    count = _count(path, changed, about is None)
    read = partial(_read, path, changed, None if about is None else about.curve, count)
    return FrameSequence((path.stem,) if count == 1 else numbered(count), (path,), read)


def write_mp4(path: str | Path, pictures: Tensor, *, white: float, per_second: int) -> None:
    """Write pictures as H.264 video in sRGB; small ones enlarged by a whole number.

    Parameters
    ----------
    pictures
        Linear radiance, (frames, 1 or 3, height, width).
    white
        Radiance that is white in all of them.
    per_second
        Frames in a second.

    Raises
    ------
    FileError
        If PyAV is not installed, or the file cannot be written.
    """
    library = _av()
    by = max(1, round(_MP4_ROWS / pictures.shape[-2]))
    frames = []
    for each in pictures:
        pixels = np.asarray(screen_picture(each, white).convert("RGB"))
        large = pixels.repeat(by, axis=0).repeat(by, axis=1)
        # The colours of 2×2 pixels are one: sides have to be even.
        frames.append(np.pad(large, [(0, n % 2) for n in large.shape[:2]] + [(0, 0)], "edge"))
    with (
        atomic_write(path) as temporary,
        library.open(str(temporary), "w", format="mp4") as container,
    ):
        stream = container.add_stream("libx264", rate=per_second, options={"crf": "16"})
        stream.pix_fmt = "yuv420p"
        stream.height, stream.width = frames[0].shape[:2]
        for pixels in frames:
            container.mux(stream.encode(library.VideoFrame.from_ndarray(pixels, "rgb24")))
        container.mux(stream.encode())


def has_video_support() -> bool:
    """Whether PyAV is installed."""
    return find_spec("av") is not None


def check_video_support() -> None:
    """Refuse before any work where PyAV is not installed.

    Raises
    ------
    FileError
        If it is not.
    """
    _av()


def _av() -> Any:
    try:
        import av
    except ImportError:
        raise FileError("video needs PyAV: pip install 'nolens[video]'") from None
    av.logging.set_level(av.logging.PANIC)
    return av


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """A file that is read as what its suffix says, and opens no other."""
    library = _av()
    with (
        decoding(path, "a video"),
        library.open(
            str(path), format=_DEMUXERS[path.suffix.lower()], options={"protocol_whitelist": "file"}
        ) as container,
    ):
        if not container.streams.video:
            raise FileError(f"{path} has no video in it")
        yield container


@lru_cache(maxsize=8)
def _count(path: Path, changed: int, check: bool) -> int:
    """Frames of a video, once it is known to be read; without decoding them."""
    with _opened(path) as container:
        stream = container.streams.video[0]
        coding, form = stream.codec_context.name, stream.codec_context.format.name
        check_size((stream.codec_context.height, stream.codec_context.width, 3), 2, path)
        known = _PLAIN.fullmatch(form) or _BAYER.fullmatch(form) or form in _REVERSED
        if check and (coding not in _LOSSLESS or not known):
            raise FileError(
                f"{path} is {coding} video of {form}, whose values are not proportional to light: "
                f"{_RECORD}; or say what they are in {path.with_suffix('.toml').name}: "
                'curve = "srgb" or "linear"'
            )
        return stream.frames or sum(1 for packet in container.demux(stream) if packet.size)


class _Decoder:
    """Decodes one video, frame after frame; going back begins anew."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frames: Iterator[Any] = iter(())
        self._next = -1
        self._lock = threading.Lock()

    def frame(self, number: int) -> Any:
        with self._lock:
            if self._next < 0 or number < self._next:
                self._frames, self._next = self._all(), 0
            for frame in self._frames:
                self._next += 1
                if self._next > number:
                    return frame
        raise FileError(f"{self._path} ends before its frame {number + 1}: it is incomplete")

    def _all(self) -> Iterator[Any]:
        with _opened(self._path) as container:
            yield from container.decode(container.streams.video[0])


@lru_cache(maxsize=1)
def _decoder(path: Path, changed: int) -> _Decoder:
    return _Decoder(path)


def _read(path: Path, changed: int, curve: str | None, count: int, number: int) -> Frame:
    decoded = _decoder(path, changed).frame(number)
    with decoding(path, "a video"):
        values, mosaic, bits = _values(decoded, curve is not None)
    source = str(path) if count == 1 else f"{path}#{number + 1}"
    frame = frame_from_array(values, source)
    white = 2.0**bits - 1
    if curve == "srgb":
        linear = linear_from_srgb(frame.counts / white) * white
        return replace(frame, counts=linear, white=white, stored_as="float32", black_stated=True)
    channels = frame.channels if mosaic is None else ("mosaic",)
    return replace(frame, white=white, channels=channels, mosaic=mosaic)


def _values(decoded: Any, converted: bool) -> tuple[NDArray[Any], str | None, int]:
    """Counts (channels, height, width) of a decoded frame, its mosaic, and bits of a count."""
    form = decoded.format.name
    bayer = _BAYER.fullmatch(form)
    bits = 16 if form.endswith("16le") else decoded.format.components[0].bits
    if bayer is not None:
        return _plane(decoded, bits // 8)[None], bayer[1].upper(), bits
    if form in _REVERSED:
        return np.moveaxis(_plane(decoded, 1, _REVERSED[form])[..., 2::-1], -1, 0), None, 8
    if not _PLAIN.fullmatch(form) and converted:
        return np.moveaxis(decoded.to_ndarray(format="rgb24"), -1, 0), None, 8
    array = decoded.to_ndarray()
    return array[None] if array.ndim == 2 else np.moveaxis(array, -1, 0), None, bits


def _plane(decoded: Any, itemsize: int, channels: int = 1) -> NDArray[Any]:
    """The one plane of a frame, (height, width[, channels])."""
    plane = decoded.planes[0]
    rows = np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)[: decoded.height]
    row = np.ascontiguousarray(rows[:, : decoded.width * itemsize * channels])
    values = row.view("<u2" if itemsize == 2 else "u1")
    return values if channels == 1 else values.reshape(decoded.height, decoded.width, channels)
