"""The forward model of a mask-based lensless camera."""

import torch
from torch import Tensor

from nolens.kernels import irfft2, rfft2
from nolens.operators.base import LinearOperator
from nolens.operators.geometry import Geometry, Region


class CroppedConvolution(LinearOperator):
    r"""Crop of a linear convolution, b = C M v: eq. 6 of the paper (`uvimprint`).

    b[i] = Σ_s v[s] h[i − s + c], i on the sensor, with the PSF h and its centre
    c = (height // 2, width // 2).

    Parameters
    ----------
    psf
        `(channels, height, width)`, or one channel for all; of the sensor's size or wider, at
        the sensor's pitch.
    sensor
        (height, width) of the measurement.
    region
        Cells that light can come from. With it, the operator takes scenes of the region's
        size; without, of the whole period (`geometry.period`), in which the sensor's frame
        lies at `geometry.sensor`.

    Raises
    ------
    OptionError
        If no light from the region reaches the sensor.
    """

    def __init__(self, psf: Tensor, sensor: tuple[int, int], region: Region | None = None) -> None:
        self.sensor = sensor
        self.channels = psf.shape[-3]
        self._channel_axis = (self.channels,) if self.channels > 1 else ()
        self.geometry = Geometry.lay_out(sensor, (psf.shape[-2], psf.shape[-1]), region)
        top, left, height, width = self.geometry.psf
        kernel = psf.new_zeros((self.channels, *self.geometry.period))
        kernel[:, :height, :width] = psf[:, top : top + height, left : left + width]
        self.transfer = rfft2(torch.roll(kernel, self.geometry.psf_shift, (-2, -1)))
        """Half spectrum of the PSF, (channels, height, width // 2 + 1) of the period."""

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the scene: the region, or the whole period; channels first where fixed."""
        return (*self._channel_axis, *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Size of the measurement; channels first where the PSF fixes their number."""
        return (*self._channel_axis, *self.sensor)

    def embed(self, scene: Tensor) -> Tensor:
        """Scene on the whole period, zero outside the region."""
        return _embed(scene, self.geometry.scene, self.geometry.period)

    def _forward(self, v: Tensor) -> Tensor:
        period = self.embed(v)
        image = irfft2(rfft2(period) * self.transfer, self.geometry.period)
        return _crop(image, self.geometry.sensor)

    def _adjoint(self, y: Tensor) -> Tensor:
        period = _embed(y, self.geometry.sensor, self.geometry.period)
        back = irfft2(rfft2(period) * self.transfer.conj(), self.geometry.period)
        return _crop(back, self.geometry.scene)


def _embed(small: Tensor, window: tuple[int, int, int, int], period: tuple[int, int]) -> Tensor:
    top, left, height, width = window
    large = small.new_zeros((*small.shape[:-2], *period))
    large[..., top : top + height, left : left + width] = small
    return large


def _crop(large: Tensor, window: tuple[int, int, int, int]) -> Tensor:
    top, left, height, width = window
    return large[..., top : top + height, left : left + width]
