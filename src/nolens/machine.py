"""The device to compute on, its memory, and what goes into a file where that would not do."""

import os
import shutil
import tempfile
from pathlib import Path
from typing import Literal

import numpy as np
import psutil
import torch
from torch import Tensor

from nolens.errors import FileError, OptionError

DeviceName = Literal["auto", "cpu", "cuda"]
BYTES_OF_PROGRAM = 5e8
"""Beside what the work itself holds."""
_ABSURD_BYTES = 1e15


def check_memory(needed: float, device: torch.device, remedy: str, mapped: float = 0.0) -> bool:
    """Refuse what the machine has no memory for; whether a part of it must go into a file.

    Parameters
    ----------
    needed
        Bytes that the work holds at once.
    device
        Where it computes.
    remedy
        What would need less, as the end of a sentence.
    mapped
        Bytes of these that can be in a temporary file (`mapped_copy`).

    Raises
    ------
    OptionError
        If the machine has less memory than the rest needs, or no disk has room for that file.
    """
    where, there = "CUDA device" if device.type == "cuda" else "machine", memory_bytes(device)
    if needed <= there:
        return False
    short = (
        f"this needs about {gigabytes(needed)} of memory, and the {where} has {gigabytes(there)}"
    )
    if needed - mapped > there:
        aside = f", even with {gigabytes(mapped)} of it in a file" if mapped else ""
        raise OptionError(f"{short}{aside}: {remedy}")
    folder, room = tempfile.gettempdir(), _room_on_disk()
    if mapped > room:
        raise OptionError(
            f"{short}: {gigabytes(mapped)} of it can be in a temporary file, and the folder "
            f"{folder} has {gigabytes(room)} on a disk. Name another by TMPDIR; {remedy}"
        )
    return True


def mapped_copy(tensor: Tensor) -> Tensor:
    """A copy in the CPU's address space, mapped to a temporary file (`tempfile.gettempdir`).

    The operating system keeps in memory what there is memory for, and reads the rest when it is
    used. The file has no name: it goes with the copy, or with the process, whatever ends that.

    Raises
    ------
    FileError
        If the file cannot be made, or there is no room for it.
    """
    try:
        with tempfile.TemporaryFile() as file:
            if hasattr(os, "posix_fallocate"):  # Without room, the copy would end the process.
                os.posix_fallocate(file.fileno(), 0, tensor.nbytes)
            values = np.memmap(file, np.uint8, "w+", shape=(tensor.nbytes,))
    except OSError as error:
        raise FileError(
            f"cannot write a temporary file of {gigabytes(tensor.nbytes)} into "
            f"{tempfile.gettempdir()}: {error.strerror or error}. Name a folder on a disk with "
            "room by TMPDIR"
        ) from error
    return torch.from_numpy(values).view(tensor.dtype).view(tensor.shape).copy_(tensor)


def mapped_note(size: float) -> str:
    """What to say of tensors of so many bytes in files."""
    return (
        f"memory would not do for all PSFs: {gigabytes(size)} of their transforms at most are in a "
        f"temporary file in {tempfile.gettempdir()} and read in each iteration, which is slower"
    )


def _room_on_disk() -> float:
    """Free bytes for temporary files; none where their folder is in memory itself."""
    folder = Path(tempfile.gettempdir()).resolve()
    above = [
        each for each in psutil.disk_partitions(all=True) if folder.is_relative_to(each.mountpoint)
    ]
    nearest = max(above, key=lambda each: len(each.mountpoint), default=None)
    if nearest is not None and nearest.fstype in ("tmpfs", "ramfs"):
        return 0.0
    return float(shutil.disk_usage(folder).free)


def memory_bytes(device: torch.device) -> float:
    """All memory that a device has."""
    if device.type == "cuda":
        return float(torch.cuda.mem_get_info(device)[1])
    return float(psutil.virtual_memory().total)


def gigabytes(number: float) -> str:
    """Bytes, as a text in GB."""
    return f"{number / 1e9:.1f} GB" if number < _ABSURD_BYTES else f"{number / 1e9:.0e} GB"


def pick_device(name: DeviceName) -> torch.device:
    """Find the device of a name; auto takes CUDA where there is one.

    Raises
    ------
    OptionError
        If CUDA is asked for and there is none.
    """
    if name == "cuda" and not torch.cuda.is_available():
        raise OptionError(
            "--device cuda was asked for, but torch finds no CUDA device here; use "
            "--device cpu or auto, or install a CUDA build of torch"
        )
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)
