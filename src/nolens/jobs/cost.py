"""Whether the machine has the memory that a job needs."""

import psutil
import torch

from nolens.errors import OptionError
from nolens.jobs.reporter import Reporter

BYTES_OF_PROGRAM = 5e8
_MUCH = 1e9
_ABSURD = 1e15


def check_memory(needed: float, device: torch.device, remedy: str) -> None:
    """Refuse what the machine has no memory for.

    Parameters
    ----------
    needed
        Bytes that the job holds at once.
    device
        Where the job computes.
    remedy
        What would need less, as the end of a sentence.

    Raises
    ------
    OptionError
        If the machine has less memory than that.
    """
    where, there = "machine", float(psutil.virtual_memory().total)
    if device.type == "cuda":
        where, there = "CUDA device", float(torch.cuda.mem_get_info(device)[1])
    if needed > there:
        raise OptionError(
            f"this needs about {_gigabytes(needed)} GB of memory, and the {where} has "
            f"{_gigabytes(there)} GB: {remedy}"
        )


def announce(needed: float, reporter: Reporter) -> None:
    """Say beforehand what takes gigabytes.

    Parameters
    ----------
    needed
        Bytes that the job holds at once.
    reporter
        Is told.
    """
    if needed > _MUCH:
        reporter.note(f"this takes about {_gigabytes(needed)} GB of memory")


def _gigabytes(number: float) -> str:
    return f"{number / 1e9:.1f}" if number < _ABSURD else f"{number / 1e9:.0e}"
