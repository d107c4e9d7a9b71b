"""State files: where an interrupted run stands, as npz."""

import json
import os
import struct
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from nolens.documents import parse_json
from nolens.errors import FileError, NolensError
from nolens.files.atomic import atomic_write
from nolens.files.input import check_exists, readable

_ABOUT = "about"
_ACCEPTED = "Accepted is a state file that an interrupted run wrote (.npz)"

_SMALL = 4096
"""Bytes of an array's header, and of the sums that a run has not gathered yet."""
_LONGEST_ABOUT = _LONGEST_LIST = 2**20
_TAIL = 2**16 + 64
"""Bytes at the end of an archive that say where its list is."""


def write_state(path: str | Path, arrays: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Write tensors by name as .npz, and as JSON what a run must share to go on from here.

    Raises
    ------
    FileError
        If the file cannot be written.
    """
    values = {name: tensor.detach().cpu().numpy() for name, tensor in arrays.items()}
    with atomic_write(path) as temporary:
        np.savez(temporary, allow_pickle=False, **{_ABOUT: np.array(json.dumps(about)), **values})


def read_state(
    path: str | Path, like: Mapping[str, Tensor], belongs: Callable[[Mapping[str, Any]], None]
) -> dict[str, Tensor]:
    """Read what `write_state` wrote, and nothing that is not like it.

    Parameters
    ----------
    like
        Arrays of the run that goes on, by name: of their types, and no larger, are those that
        are read. What is missing is left out.
    belongs
        Is given what run the file belongs to, and raises where it is another one.

    Raises
    ------
    FileError
        If the file is missing, damaged or something else.
    """
    path = Path(path)
    check_exists(path, _ACCEPTED)
    try:
        _check_list(path)
        with np.errstate(all="ignore"), zipfile.ZipFile(path) as archive:
            members = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
            if extra := sorted(members.keys() - like.keys() - {_ABOUT}):
                raise _no_state(path, f"it holds {readable(extra[0])[:40]!r}")
            belongs(_read_about(path, archive, members[_ABOUT]))
            return {
                name: _read_array(path, archive, info, name, like[name])
                for name, info in members.items()
                if name != _ABOUT
            }
    except NolensError:
        raise
    # A damaged archive can raise nearly anything.
    except Exception as error:
        raise _no_state(path, "it is damaged or incomplete") from error


def read_about(path: Path) -> dict[str, Any]:
    """What run a state file belongs to, for runs whose arrays depend on it.

    Raises
    ------
    FileError
        If the file is missing, damaged or something else.
    """
    check_exists(path, _ACCEPTED)
    try:
        _check_list(path)
        with zipfile.ZipFile(path) as archive:
            return _read_about(path, archive, archive.getinfo(f"{_ABOUT}.npy"))
    except NolensError:
        raise
    # A damaged archive can raise nearly anything.
    except Exception as error:
        raise _no_state(path, "it is damaged or incomplete") from error


def _check_list(path: Path) -> None:
    """Refuse an archive whose list of members is longer than that of any state."""
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        file.seek(max(0, size - _TAIL))
        tail = file.read()
    end = tail[tail.rfind(b"PK\5\6") :]
    large = size > 2**31  # Of which a second list may tell the place.
    if struct.unpack("<I", end[12:16])[0] > _LONGEST_LIST or (b"PK\6\7" in tail and not large):
        raise _no_state(path, "its list of arrays is too long")


def _read_about(path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> dict[str, Any]:
    if info.file_size > _LONGEST_ABOUT:
        raise _no_state(path, f"{_ABOUT!r} has {info.file_size} bytes")
    with archive.open(info) as file:
        text = np.lib.format.read_array(file, allow_pickle=False)
    if text.dtype.kind != "U" or text.ndim:
        raise _no_state(path, f"{_ABOUT!r} is no text")
    about = parse_json(str(text), str(path))
    if not isinstance(about, dict):
        raise _no_state(path, f"{_ABOUT!r} is no table")
    return about


def _read_array(
    path: Path, archive: zipfile.ZipFile, info: zipfile.ZipInfo, name: str, like: Tensor
) -> Tensor:
    needed = like.element_size() * like.numel()
    if info.file_size > needed + _SMALL:
        raise _no_state(
            path, f"its array {name} has {info.file_size} bytes, and this run's has {needed}"
        )
    with archive.open(info) as file:
        array = np.lib.format.read_array(file, allow_pickle=False)
    if torch.from_numpy(array).dtype != like.dtype:
        raise _no_state(path, f"its array {name} holds {array.dtype}")
    return torch.from_numpy(array)


def _no_state(path: Path, why: str) -> FileError:
    return FileError(f"{path} is no state file of this run: {why}. {_ACCEPTED}")
