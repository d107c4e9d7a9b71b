"""Files that somebody gives: what is refused of them before a library decodes them, and texts.

Nothing here loads more than the standard library, so that the studio's server can use it.
"""

import difflib
import math
import os
import re
import stat
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from nolens.amounts import size_text
from nolens.documents import LONGEST_JSON
from nolens.errors import FileError, OptionError
from nolens.quantities import DataSize

READ_LIMIT = 1_500_000_000
"""Bytes that one read may decode where nothing else is set: 125 megapixels of three colours."""

RAW_SUFFIXES = (
    ".dng",
    ".cr2",
    ".cr3",
    ".crw",
    ".nef",
    ".nrw",
    ".arw",
    ".sr2",
    ".raf",
    ".rw2",
    ".orf",
    ".pef",
    ".srw",
    ".3fr",
    ".iiq",
    ".raw",
)
"""Suffixes of camera raw of all makers."""

DESCRIBE_BARE = (
    "write a .toml of the same name beside it, or a raw.toml for all of the folder, with width, "
    'height and format, such as "SRGGB10_CSI2P" or "BayerRG12p" (docs/formats.md)'
)
"""What to do about a sensor's bare data that nothing describes."""

_SIGNATURES = (
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\x93NUMPY", "npy"),
    (b"\xff\xd8\xff", "JPEG"),
    (b"GIF8", "GIF"),
    (b"BM", "BMP"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"II+\0", "TIFF"),
    (b"MM\0+", "TIFF"),
    (b"PK\3\4", "zip"),
    (b"\x89HDF\r\n\x1a\n", "HDF5"),
    (b"\x76\x2f\x31\x01", "EXR"),
)
_KNOWN = ("PNG", "TIFF", "npy", "HDF5", "EXR")
_LEAST, _MOST = 10**6, 10**15
_FLOAT = 4
_LONGEST_REASON = 160
_HALF_CHARACTERS = re.compile("[\ud800-\udfff]")
_limit = READ_LIMIT


def readable(text: str | Path) -> str:
    """A path, or a text with one in it, to print and store: bytes that are no UTF-8 as U+FFFD."""
    return _HALF_CHARACTERS.sub("\ufffd", os.fspath(text))


@contextmanager
def system_errors(path: Path) -> Iterator[None]:
    """Turn what the system says of a file or folder that cannot be read into a `FileError`."""
    try:
        yield
    except OSError as error:
        raise FileError(f"cannot read {path}: {error.strerror or error}") from error


def check_exists(path: Path, accepted: str) -> None:
    """Refuse a path that is no file; messages end with what would be accepted, without a full stop.

    Raises
    ------
    FileError
        If there is nothing (with the nearest name in its folder), a folder, or a device.
    """
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        message = f"there is no file {path}"
        if not path.parent.is_dir():
            message += f", and no folder {path.parent}"
        else:
            names = [other.name for other in path.parent.iterdir() if other.is_file()]
            near = difflib.get_close_matches(path.name, names, n=1)
            message += f". Did you mean {path.with_name(near[0])}?" if near else " in its folder"
        raise FileError(message) from None
    except (OSError, ValueError) as error:
        raise FileError(f"cannot read {path}: {error}") from error
    if stat.S_ISDIR(mode):
        raise FileError(f"{path} is a folder: give the name of a file in it. {accepted}")
    if not stat.S_ISREG(mode):
        raise FileError(f"{path} is no file but a device or a pipe. {accepted}")


def check_content(path: Path, expected: tuple[str | None, ...], accepted: str) -> None:
    """Refuse a file whose first bytes are of no kind that its suffix can stand for.

    The kind None is any without known first bytes; `accepted` is as in `check_exists`.

    Raises
    ------
    FileError
        If it is empty, cannot be read, or is of another kind.
    """
    suffix = path.suffix.lower()
    with system_errors(path), path.open("rb") as file:
        start = file.read(8)
    if not start:
        raise FileError(f"{path} is empty: copy it again from where it was made")
    kind = next((name for mark, name in _SIGNATURES if start.startswith(mark)), None)
    if kind in expected:
        return
    if kind is None:
        raise FileError(
            f"{path} does not hold what its suffix {suffix} says: it is no {expected[0]} file. "
            f"{accepted}"
        )
    raise FileError(
        f"{path} has the suffix {suffix}, but it is a {kind} file"
        + (": give it the suffix that fits" if kind in _KNOWN else "")
        + f". {accepted}"
    )


def read_limit() -> int:
    """Bytes that one read may decode in this process."""
    return _limit


def set_read_limit(size: str | int) -> None:
    """Set how much one read may decode in this process: text such as ``"4GB"``, or bytes.

    Processes that are started later do not take it over: tell each of them.

    Raises
    ------
    OptionError
        If it is no size, below 1 MB or above 1e6 GB.
    """
    global _limit
    limit = DataSize.parse(size) if isinstance(size, str) else DataSize.of(size, "B")
    if not _LEAST <= limit.exact <= _MOST:
        raise OptionError(f"--read-limit {limit}: give 1MB to 1000000GB, such as 4GB")
    _limit = int(limit.exact)


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
    """Refuse a file whose bytes, at `cost` bytes of memory for each, are more than one read takes.

    Raises
    ------
    FileError
        If it is too large, or cannot be read.
    """
    with system_errors(path):
        size = path.stat().st_size
    if size * cost > _limit:
        raise _too_large(f"{path} has {size_text(size)}", size * cost)


def check_part(decoded: int, coded: int, source: str | Path) -> None:
    """Refuse a strip or tile whose bytes take too much beside the picture while it is decoded.

    Raises
    ------
    FileError
        If it is too large.
    """
    if decoded + coded > _limit:
        raise _too_large(f"{source} has {size_text(decoded)} in one strip or tile", decoded + coded)


def _too_large(what: str, size: int) -> FileError:
    # A little more than it takes, in two digits.
    step = 10 ** max(6, math.floor(math.log10(size)) - 1)
    return FileError(
        f"{what}, for which {size_text(size)} are needed; one read may take "
        f"{size_text(_limit)}. If the file is what it should be, allow it more with --read-limit "
        f"{size_text((size // step + 1) * step).replace(' ', '')}"
    )


@contextmanager
def decoding(path: Path, kind: str, advice: str = "") -> Iterator[None]:
    """Turn what a library raises for a damaged file, which can be nearly anything, into our error.

    Parameters
    ----------
    path
        The file.
    kind
        What it was to be, with its article.
    advice
        What to do, as a sentence without its full stop; to copy it again where it is left out.

    Raises
    ------
    FileError
        With the start of what the library says.
    """
    try:
        yield
    except FileError:
        raise
    except Exception as error:
        first = error.args[0] if error.args else None
        text = first.decode(errors="replace") if isinstance(first, bytes) else str(error)
        reason = " ".join(text.split())
        # Objects show themselves as <... at 0x7f...>, which says nothing to a person.
        clear = reason and reason.isprintable() and "<" not in reason
        why = f" ({reason[:_LONGEST_REASON]})" if clear else ""
        raise FileError(
            f"{path} cannot be read as {kind}: it is damaged or incomplete{why}. "
            + (advice or "Copy it again from where it was made")
        ) from error


@contextmanager
def quiet_stderr() -> Iterator[None]:
    """Send what C code writes to standard error nowhere, for the whole process."""
    try:
        original = os.dup(2)
    except OSError:  # Standard error is closed: there is nothing to keep quiet.
        yield
        return
    try:
        with Path(os.devnull).open("wb") as sink:
            os.dup2(sink.fileno(), 2)
            yield
    finally:
        os.dup2(original, 2)
        os.close(original)


def read_text(path: str | Path, kind: str = "TOML file", advice: str = "") -> str:
    """Read a text file of at most 16 million bytes.

    Parameters
    ----------
    path
        The file; ~ at its beginning stands for the home folder.
    kind
        What it is to be, for messages.
    advice
        What to do where it cannot be read, as a sentence without its full stop.

    Raises
    ------
    FileError
        If there is no such file, or it cannot be read, is longer, or no UTF-8.
    """
    end = f". {advice}" if advice else ""
    try:
        path = Path(path).expanduser()
        # A pipe would wait for ever for somebody to write into it.
        if not stat.S_ISREG(path.stat().st_mode) and not path.is_dir():
            raise FileError(f"cannot read {path}: it is no file but a device or a pipe{end}")
        with path.open("rb") as file:
            content = file.read(LONGEST_JSON + 1)
    # The names of no user, and characters that no path can have, are no OSError.
    except (OSError, ValueError, RuntimeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"cannot read {path}: {reason}{end}") from error
    if len(content) > LONGEST_JSON:
        raise FileError(
            f"{path} has more than {LONGEST_JSON // 10**6} million bytes, which no {kind} has{end}"
        )
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FileError(f"{path} is no {kind}: {error}") from error


def named_pairs(measured: Path, pictures: Path) -> dict[str, tuple[Path, Path]]:
    """Measurements and pictures of the same name, but for the suffix, in order of the names.

    Raises
    ------
    FileError
        If a folder is none or empty, a file has no partner, or two of a folder have one name.
    """
    by_name = _by_name(measured), _by_name(pictures)
    for folder, here, there, other in (
        (measured, *by_name, pictures),
        (pictures, *by_name[::-1], measured),
    ):
        alone = sorted(here.keys() - there.keys())
        if alone:
            raise FileError(
                f"{folder / here[alone[0]].name} has no partner in {other} ({len(by_name[0])} "
                f"measurements, {len(by_name[1])} pictures): give both the same name, such as "
                f"{alone[0]}.png, and keep other files elsewhere"
            )
    if not by_name[0]:
        raise FileError(f"{measured} is empty: give a folder of measurements, and one of pictures")
    return {name: (by_name[0][name], by_name[1][name]) for name in sorted(by_name[0])}


def _by_name(folder: Path) -> dict[str, Path]:
    """Files of a folder by their names without the suffix."""
    if not folder.is_dir():
        raise FileError(f"{folder} is no folder: give one of measurements and one of pictures")
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or not path.is_file():
            continue
        if path.stem in files:
            raise FileError(
                f"{path} and {files[path.stem].name} have one name, and it is not clear which is "
                "meant: keep one of them elsewhere"
            )
        files[path.stem] = path
    return files
