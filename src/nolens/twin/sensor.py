"""From light on the pixels to the counts of a mosaic frame."""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Sensor:
    """Figures of the Sony IMX477 at gain 1, 12 bit."""

    bits: int = 12
    black_counts: int = 256
    clip_electrons: float = 8180.0
    read_noise_electrons: float = 3.0
    counts_per_electron: float = 0.47
    mosaic: str = "RGGB"

    @property
    def white_counts(self) -> int:
        """Largest count that the sensor gives."""
        return int(2**self.bits - 1)


def expose(light: Tensor, sensor: Sensor, *, fill: float, seed: int) -> Tensor:
    r"""Counts of one mosaic frame with shot and read noise.

    The exposure takes the brightest pixel to `fill` of the clipping level. A pixel of mean N
    electrons gives a Poisson number of them, plus Gaussian read noise; counts are rounded and
    clipped at black + clip · gain and at the largest count.

    Parameters
    ----------
    light
        (3, height, width): red, green and blue on cells of 2×2 pixels, ≥ 0.
    sensor
        Its figures.
    fill
        Share of the clipping level, 0 to 1.
    seed
        Of the noise.

    Returns
    -------
    Tensor
        Counts, int32, (2·height, 2·width).
    """
    generator = torch.Generator().manual_seed(seed)
    height, width = light.shape[-2:]
    mosaic = light.new_zeros((2 * height, 2 * width))
    for cell, colour in enumerate(sensor.mosaic):
        mosaic[cell // 2 :: 2, cell % 2 :: 2] = light["RGB".index(colour)]
    electrons = mosaic * (fill * sensor.clip_electrons / float(mosaic.max()))
    electrons = torch.poisson(electrons, generator=generator)
    noise = torch.randn(electrons.shape, generator=generator)
    electrons = electrons + sensor.read_noise_electrons * noise
    counts = sensor.black_counts + sensor.counts_per_electron * electrons
    clip = sensor.black_counts + sensor.counts_per_electron * sensor.clip_electrons
    return counts.clamp(0, min(clip, sensor.white_counts)).round().to(torch.int32)
