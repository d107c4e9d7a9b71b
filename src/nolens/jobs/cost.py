"""Memory and time of a simulation, foretold from the description of its camera."""

import math
from dataclasses import dataclass

import psutil
import torch

from nolens.errors import OptionError
from nolens.jobs.reporter import Reporter
from nolens.optics import Grid, Margin, PointSource
from nolens.optics.windows import windows
from nolens.twin import REFERENCE_NM, Light, Twin
from nolens.twin.point import field_step, samples_per_pixel

# Measured on two cores with the presets: seconds for one sample of the field behind the relief, of
# the intensity on the sensor and of a transform, and for one point of a relief of random lenslets.
_SECONDS_PER_FIELD = 15e-9
_SECONDS_PER_INTENSITY = 8e-9
_SECONDS_PER_TRANSFORM = 10e-9
_SECONDS_PER_POINT = 50e-9
# For what a window needs however small it is.
_SECONDS_PER_WINDOW = 2e-3
# Bytes for one sample of the largest window, of the whole pattern, and for one point of a relief.
_BYTES_PER_SAMPLE = 14
_BYTES_PER_KEPT = 6
_BYTES_PER_POINT = 20
_BYTES_OF_PROGRAM = 5e8

_MOST = 10**7
_LONG_S = 20
_MUCH = 1e9
_ABSURD = 1e15


@dataclass(frozen=True)
class Cost:
    """What a job will need.

    Parameters
    ----------
    bytes
        Most memory that is held at once.
    seconds
        On two cores.
    """

    bytes: float
    seconds: float


@dataclass(frozen=True)
class PatternSize:
    """Samples that one pattern of one wavelength takes.

    Parameters
    ----------
    field
        Of the field behind the relief: all windows, margins included.
    intensity
        Of the intensity on the sensor, in the same windows.
    largest
        Of the intensity in the largest window.
    kept
        Of the pattern itself.
    windows
        How many there are.
    """

    field: int
    intensity: int
    largest: int
    kept: int
    windows: int


def pattern_size(
    twin: Twin,
    source: PointSource,
    cells: tuple[int, int],
    pixels: int,
    *,
    at_least: int,
    shortest: float,
) -> PatternSize:
    """Count the samples of a pattern, as `nolens.twin.point` and its windows take them.

    Parameters
    ----------
    twin
        The camera, as `preview_model` gives it.
    source
        The point source.
    cells
        (rows, columns) of the result.
    pixels
        Pixels along a cell.
    at_least
        Samples along a pixel.
    shortest
        Shortest wavelength, in nm.
    """
    per_pixel = samples_per_pixel(twin, at_least=at_least)
    grid = Grid(*cells, twin.sensor_pitch_um * pixels).finer(per_pixel * pixels)
    finer = field_step(twin, grid.pitch_um, shortest_nm=shortest, distance_um=source.distance_um)
    pitch = finer * grid.pitch_um
    squared = torch.tensor(source.p**2, dtype=torch.float64)
    media = twin.media(REFERENCE_NM)
    spread = float(twin.illumination(source, REFERENCE_NM).after.spread_um(squared.sqrt()))
    turned = abs(float(media.coupling(squared))) * twin.mask.relief.steepest
    margin = Margin.needed(turned, spread, media.wavelength_um)
    margins = 2 * math.ceil(margin.total_um / pitch) * finer
    lengths = [
        [side + margins for side in _sides(count, grid.pitch_um, source.distance_um)]
        for count in (grid.rows, grid.columns)
    ]
    intensity = sum(lengths[0]) * sum(lengths[1])
    return PatternSize(
        field=intensity // finer**2,
        intensity=intensity,
        largest=max(lengths[0]) * max(lengths[1]),
        kept=grid.rows * grid.columns,
        windows=len(lengths[0]) * len(lengths[1]),
    )


def _sides(count: int, pitch_um: float, distance_um: float) -> list[int]:
    """Sides of the windows along one axis; no machine holds so many that counting takes long."""
    if count > _MOST:
        return [count]
    return [part.columns[1] - part.columns[0] for part in windows(1, count, pitch_um, distance_um)]


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


def cost_of(
    size: PatternSize, patterns: int, *, points: float, held: int, transformed: int = 0
) -> Cost:
    """Add up what some patterns need.

    Parameters
    ----------
    size
        Of one pattern.
    patterns
        How many are computed, all wavelengths counted.
    points
        Of a relief that has to be computed.
    held
        Bytes that are held all along.
    transformed
        Samples of all transforms that the patterns are blended with.
    """
    pattern = (
        size.field * _SECONDS_PER_FIELD
        + size.intensity * _SECONDS_PER_INTENSITY
        + size.windows * _SECONDS_PER_WINDOW
    )
    working = size.largest * _BYTES_PER_SAMPLE + size.kept * _BYTES_PER_KEPT
    return Cost(
        bytes=_BYTES_OF_PROGRAM + max(working + held, points * _BYTES_PER_POINT) + 4 * points,
        seconds=patterns * pattern
        + points * _SECONDS_PER_POINT
        + transformed * _SECONDS_PER_TRANSFORM,
    )


def surface_cost(points: float) -> Cost:
    """What it takes to compute a relief of so many points."""
    return cost_of(PatternSize(0, 0, 0, 0, 0), 0, points=points, held=0)


def check_memory(cost: Cost, device: torch.device, remedy: str) -> None:
    """Refuse what the machine has no memory for.

    Parameters
    ----------
    cost
        The forecast.
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
    if cost.bytes > there:
        raise OptionError(
            f"this needs about {_gigabytes(cost.bytes)} GB of memory, and the {where} has "
            f"{_gigabytes(there)} GB: {remedy}"
        )


def announce(cost: Cost, device: torch.device, reporter: Reporter) -> None:
    """Say beforehand what will take long or much memory.

    Parameters
    ----------
    cost
        The forecast.
    device
        Where the job computes; seconds are known for the CPU.
    reporter
        Is told.
    """
    slow = cost.seconds > _LONG_S and device.type == "cpu"
    if slow or cost.bytes > _MUCH:
        time = f" and {duration_text(cost.seconds)} on two cores" if device.type == "cpu" else ""
        reporter.note(f"this takes about {_gigabytes(cost.bytes)} GB of memory{time}")


def _gigabytes(number: float) -> str:
    return f"{number / 1e9:.1f}" if number < _ABSURD else f"{number / 1e9:.0e}"


def duration_text(seconds: float) -> str:
    """Say how long, in the unit that suits."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"
