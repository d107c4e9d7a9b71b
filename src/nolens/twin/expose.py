"""From electrons to the counts of a frame."""

import torch
from torch import Tensor

from nolens.camera import Sensor
from nolens.quantities import Angle
from nolens.twin.light import Light
from nolens.twin.model import Twin


def expose(
    electrons: Tensor, sensor: Sensor, *, seed: int, offset_counts: Tensor | float = 0.0
) -> Tensor:
    r"""Counts of one frame with shot and read noise.

    A pixel of mean N electrons gives a Poisson number of them, up to the full well, plus
    Gaussian read noise; times gain and counts per electron, plus the black level, rounded and
    clipped to what the bits hold (the photon transfer of `janesick2007`).

    Parameters
    ----------
    electrons
        Mean electrons of every pixel, ≥ 0, any shape. The counts, int32, have the same.
    sensor, seed
        Figures of the sensor, and the seed of the noise.
    offset_counts
        Added to the black level: a number, or an array that is broadcast over the pixels.
    """
    generator = torch.Generator().manual_seed(seed)
    # Far beyond the full well more light changes nothing, and might not fit Poisson's numbers.
    mean = electrons.float().cpu().clamp(max=10 * sensor.full_well_electrons + 1000)
    caught = torch.poisson(mean, generator=generator)
    caught.clamp_(max=sensor.full_well_electrons)
    noise = torch.randn(caught.shape, generator=generator)
    caught.add_(noise, alpha=sensor.read_noise_electrons)
    counts = caught.mul_(sensor.counts_per_electron * sensor.gain).add_(sensor.black_counts)
    counts.add_(offset_counts)
    return counts.round_().clamp_(0, sensor.white_counts).to(torch.int32)


def photocurrents(twin: Twin, light: Light, luminance_cd_m2: float) -> Tensor:
    """Electrons that a pixel frees in a second, for each sr of a scene that it sees.

    A radiance of 1 has the luminance. The result, float32, (channels,), is a current when it is
    multiplied by `Irradiated.light`.
    """
    area_m2 = twin.camera.sensor.pitch.m**2
    rates = [
        light.electrons(twin.quantum_efficiency, channel, luminance_cd_m2) * area_m2
        for channel in twin.camera.sensor.channels
    ]
    return torch.tensor(rates)


def pixel_currents(
    twin: Twin, light: Light, luminance_cd_m2: float, polarisation: Angle | None = None
) -> Tensor:
    """Electrons that each pixel frees in a second, for each sr of a scene that it sees.

    Parameters
    ----------
    twin
        The camera.
    light, luminance_cd_m2
        Spectrum of a scene, and the luminance of a radiance of 1.
    polarisation
        Angle of light that is linearly polarised; None of light that is not.

    Returns
    -------
    Tensor
        float32, (rows, columns), behind the pixels' colours or filters.
    """
    sensor, filters = twin.camera.sensor, twin.filters
    if filters is not None and filters.transmission is not None:
        behind = filters.behind(twin.quantum_efficiency)
        area_m2 = sensor.pitch.m**2
        rates = [light.electrons(behind, name, luminance_cd_m2) * area_m2 for name in behind.values]
        return torch.tensor(rates)[filters.numbers]
    currents = photocurrents(twin, light, luminance_cd_m2)
    if filters is not None:
        passed = torch.tensor([each.passes(polarisation) for each in filters.polarisers])
        return (currents * passed)[filters.numbers]
    planes = currents[:, None, None].expand(-1, sensor.rows, sensor.columns)
    return mosaic(planes, sensor.mosaic)


def mosaic(planes: Tensor, colours: str) -> Tensor:
    """Every pixel in its colour, from full-size planes of all colours.

    Parameters
    ----------
    planes
        (3, rows, columns) of R, G and B, or (1, rows, columns).
    colours
        Colours of the 2×2 superpixel row by row, or ``"none"``.

    Returns
    -------
    Tensor
        (rows, columns).
    """
    if colours == "none":
        return planes[0]
    out = torch.empty_like(planes[0])
    for number, colour in enumerate(colours):
        row, column = divmod(number, 2)
        out[row::2, column::2] = planes["RGB".index(colour), row::2, column::2]
    return out
