"""Whether the machine has the memory that a job needs."""

import psutil
import torch

from nolens.errors import OptionError
from nolens.jobs.reporter import Reporter
from nolens.optics import surface_bytes
from nolens.twin import Light, Twin

BYTES_OF_PROGRAM = 5e8
_MUCH = 1e9
_ABSURD = 1e15


def colours_of(twin: Twin, light: Light, wavelengths: int) -> list[tuple[tuple[float, float], ...]]:
    """Wavelengths and weights of all channels, of a light that the sensor sees.

    Raises
    ------
    OptionError
        If a channel sees nothing of a spectrum, none sees a single wavelength, or the index of a
        layer is not known there.
    """
    efficiency, channels = twin.quantum_efficiency, twin.camera.sensor.channels
    if not any(light.electrons(efficiency, channel, 1.0) > 0 for channel in channels):
        first, last = efficiency.wavelength_nm[0], efficiency.wavelength_nm[-1]
        raise OptionError(
            f"the sensor sees nothing of the light {light.name}: its quantum efficiency is given "
            f"from {first:g} to {last:g} nm, and zero elsewhere; choose another --light"
        )
    colours = [light.wavelengths(efficiency, channel, wavelengths) for channel in channels]
    for colour in colours:
        for wavelength_nm, _ in colour:
            twin.media(wavelength_nm)
    return colours


def surface_cost(points: float) -> float:
    """Bytes that a job holds which computes a surface of so many points."""
    return BYTES_OF_PROGRAM + surface_bytes(points)


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
