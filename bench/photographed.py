"""A photograph that fills a part of the view, as a sensor sees it through a random mask.

The PSF is `caustic.LensletMask`'s, at half the sensor's pitch and then averaged; shot noise for a
full well at 90 % of the paper's sensor, and its read noise. Light that falls beside the PSF's
cells is not simulated: the measurement has no error but noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from caustic import LensletMask, caustic_psf
from nolens.camera import linear_from_srgb
from nolens.operators import CroppedConvolution, PixelRectangle

FULL_ELECTRONS = 0.9 * 8180
READ_ELECTRONS = 3.0
PITCH_UM = 3.1
RED, GREEN, BLUE = (590.0, 620.0, 650.0), (500.0, 530.0, 560.0), (430.0, 460.0, 490.0)
GREEN_ALONE = (GREEN,)
COLOURS = (RED, GREEN, BLUE)


@dataclass(frozen=True)
class Shot:
    """What was measured, of what, through what; all (channels, height, width)."""

    psf: Tensor
    data: Tensor
    truth: Tensor
    support: PixelRectangle
    """Of the truth, in the sensor's frame."""


def mask_psf(cells: tuple[int, int], bands_nm: tuple[tuple[float, ...], ...]) -> Tensor:
    """Mean intensity over every band, a channel for each."""
    fine_cells = (2 * cells[0], 2 * cells[1])
    wavelengths = tuple(wavelength for band in bands_nm for wavelength in band)
    fine = caustic_psf(LensletMask(), fine_cells, PITCH_UM / 2, wavelengths)
    channels = torch.stack([part.mean(dim=0) for part in fine.chunk(len(bands_nm))])
    return nnf.avg_pool2d(channels[None], 2)[0]


def linear_light(photograph: object, side: int, channels: int) -> Tensor:
    """A photograph of scikit-image on side×side cells: green alone, or all three colours."""
    encoded = torch.as_tensor(photograph).permute(2, 0, 1).float() / 255
    encoded = encoded[1:2] if channels == 1 else encoded
    light: Tensor = nnf.interpolate(
        linear_from_srgb(encoded)[None], size=(side, side), mode="bilinear", antialias=True
    )[0]
    return light


def shot(truth: Tensor, psf: Tensor, sensor: tuple[int, int]) -> Shot:
    """The measurement of a scene in the middle of the view."""
    support = PixelRectangle.centred(truth.shape[-2], truth.shape[-1], sensor)
    light = CroppedConvolution(psf, sensor, support)(truth).clamp_min(0)
    electrons = light * (FULL_ELECTRONS / float(light.max()))
    generator = torch.Generator().manual_seed(3)
    data = torch.poisson(electrons, generator=generator)
    data += READ_ELECTRONS * torch.randn(data.shape, generator=generator)
    return Shot(psf, data, truth, support)
