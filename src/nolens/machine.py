"""The device to compute on, and refusals of work that it has no memory for."""

from typing import Literal

import psutil
import torch

from nolens.errors import OptionError

DeviceName = Literal["auto", "cpu", "cuda"]
BYTES_OF_PROGRAM = 5e8
"""Beside what the work itself holds."""
_ABSURD_BYTES = 1e15


def check_memory(needed: float, device: torch.device, remedy: str) -> None:
    """Refuse what the machine has no memory for.

    Parameters
    ----------
    needed
        Bytes that the work holds at once.
    device
        Where it computes.
    remedy
        What would need less, as the end of a sentence.

    Raises
    ------
    OptionError
        If the machine has less memory than that.
    """
    where, there = "CUDA device" if device.type == "cuda" else "machine", memory_bytes(device)
    if needed > there:
        raise OptionError(
            f"this needs about {gigabytes(needed)} of memory, and the {where} has "
            f"{gigabytes(there)}: {remedy}"
        )


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
