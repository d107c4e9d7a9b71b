"""How much one read of a file may decode, checked on what its header says of it before."""

import math
from collections.abc import Sequence
from pathlib import Path

from nolens.errors import FileError, OptionError
from nolens.quantities import DataSize

READ_LIMIT = 1_500_000_000
"""Bytes that one read may decode where nothing else is set: 125 megapixels of three colours."""

_LEAST, _MOST = 10**6, 10**15
_FLOAT = 4
_limit = READ_LIMIT


def read_limit() -> int:
    """Bytes that one read may decode in this process."""
    return _limit


def set_read_limit(size: str | int) -> None:
    """Set how much one read may decode in this process.

    Processes that are started later do not take it over: tell each of them.

    Parameters
    ----------
    size
        Such as ``"4GB"``, or bytes.

    Raises
    ------
    OptionError
        If it is no size, below 1 MB or above 1e6 GB.
    """
    global _limit
    given = DataSize.parse(size) if isinstance(size, str) else DataSize.of(size, "B")
    if not _LEAST <= given.exact <= _MOST:
        raise OptionError(f"--read-limit {given}: give 1MB to 1000000GB, such as 4GB")
    _limit = int(given.exact)


def check_size(shape: Sequence[int], itemsize: int, source: str | Path) -> None:
    """Refuse an array that is larger than one read may decode.

    Parameters
    ----------
    shape
        As the header says it.
    itemsize
        Bytes of one stored value; less than four count as four, as arrays become float32.
    source
        Where it comes from, for messages.

    Raises
    ------
    FileError
        If it is too large.
    """
    # Without numpy's integers, which overflow.
    size = math.prod(int(each) for each in shape) * max(itemsize, _FLOAT)
    if size > _limit:
        text = "×".join(str(int(each)) for each in shape)
        raise _too_large(f"{source} holds {text} values", size)


def check_bytes(path: Path, cost: int = 1) -> None:
    """Refuse a file whose bytes are more than one read may take.

    Parameters
    ----------
    path
        The file.
    cost
        Bytes of memory that each byte of it takes.

    Raises
    ------
    FileError
        If it is too large, or cannot be read.
    """
    try:
        size = path.stat().st_size
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error
    if size * cost > _limit:
        raise _too_large(f"{path} has {_text(size)}", size * cost)


def check_part(decoded: int, coded: int, source: str | Path) -> None:
    """Refuse a part of a picture that takes too much beside the picture while it is decoded.

    Parameters
    ----------
    decoded, coded
        Bytes of the part.
    source
        Where it comes from, for messages.

    Raises
    ------
    FileError
        If it is too large.
    """
    if decoded + coded > _limit:
        raise _too_large(f"{source} has {_text(decoded)} in one strip or tile", decoded + coded)


def _too_large(what: str, size: int) -> FileError:
    # A little more than it takes, in two digits.
    step = 10 ** max(6, math.floor(math.log10(size)) - 1)
    return FileError(
        f"{what}, for which {_text(size)} are needed; one read may take {_text(_limit)}. If the "
        "file is what it should be, allow it more with --read-limit "
        f"{_text((size // step + 1) * step).replace(' ', '')}"
    )


def _text(size: int) -> str:
    return f"{size / 1e9:.3g} GB" if size >= 10**9 else f"{size / 1e6:.3g} MB"
