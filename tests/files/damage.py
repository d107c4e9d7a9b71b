"""Damaged copies of a good file, for every reader."""

import random
from collections.abc import Iterator
from pathlib import Path

import torch

from nolens.camera import Frame
from nolens.errors import FileError
from nolens.files import read_frame


def truncated(good: Path) -> Iterator[Path]:
    """Copies of a file cut at many lengths: all short ones, and steps up to the last byte."""
    data = good.read_bytes()
    lengths = {*range(min(len(data), 300)), *range(0, len(data), max(1, len(data) // 60))}
    lengths |= {len(data) - n for n in range(1, min(len(data), 30))}
    for length in sorted(lengths):
        yield _copy(good, data[:length])


def garbled(good: Path, start: int, stop: int, times: int) -> Iterator[Path]:
    """Copies of a file with some of the bytes from start to stop replaced by others."""
    data, chance = good.read_bytes(), random.Random(0)
    for _ in range(times):
        other = bytearray(data)
        for _ in range(chance.choice([1, 4, 16])):
            other[chance.randrange(start, min(stop, len(data)))] = chance.randrange(256)
        yield _copy(good, bytes(other))


def _copy(good: Path, data: bytes) -> Path:
    path = good.with_name(f"damaged{good.suffix}")
    path.write_bytes(data)
    return path


def read_or_refuse(path: Path) -> Frame | None:
    """Read a file; None where it is refused as it should be. Anything else is raised."""
    try:
        return read_frame(path)
    except FileError:
        return None


def check_truncated(good: Path) -> None:
    """A file that was cut is refused, or it has lost nothing of its picture."""
    whole = read_frame(good).counts
    refused = 0
    for path in truncated(good):
        frame = read_or_refuse(path)
        refused += frame is None
        assert frame is None or torch.equal(frame.counts, whole), path.stat().st_size
    assert refused > 50
