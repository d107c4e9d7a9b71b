"""The forward model of a mask-based lensless camera."""

import torch
from torch import Tensor

from nolens.kernels import irfft2_window_, rfft2_window
from nolens.kernels.fft import Window
from nolens.operators.base import LinearOperator
from nolens.operators.geometry import Geometry, Region


class CroppedConvolution(LinearOperator):
    r"""Crop of a linear convolution, b = C M v: eq. 6 of the paper (`uvimprint`).

    b[i] = Σ_s v[s] h[i − s + c], i on the sensor, with the PSF h and its centre
    c = (height // 2, width // 2).

    Parameters
    ----------
    psf
        `(channels, height, width)`, or one channel for all; of the sensor's size or larger, at
        the sensor's pitch.
    sensor
        (height, width) of the measurement.
    region
        Pixels that light can come from. With it, the operator takes scenes of the support's
        size; without, of the whole period (`geometry.period`), in which the sensor's frame
        lies at `geometry.sensor`.

    Raises
    ------
    OptionError
        If no light from the support reaches the sensor.
    """

    def __init__(self, psf: Tensor, sensor: tuple[int, int], region: Region | None = None) -> None:
        self.sensor = sensor
        self.region = region
        self.channels = psf.shape[-3]
        self._channel_axis = (self.channels,) if self.channels > 1 else ()
        self.geometry = Geometry.lay_out(sensor, (psf.shape[-2], psf.shape[-1]), region)
        top, left, height, width = self.geometry.psf
        period = self.geometry.period
        self.transfer = torch.empty(
            (self.channels, period[0], period[1] // 2 + 1),
            dtype=psf.dtype.to_complex(),
            device=psf.device,
        )
        """Half spectrum of the PSF, (channels, height, width // 2 + 1) of the period."""
        for plane, transfer in zip(psf, self.transfer, strict=True):
            part = plane[top : top + height, left : left + width]
            rfft2_window(part, self.geometry.psf_shift, period, transfer)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the scene: the support, or the whole period; channels first where fixed."""
        return (*self._channel_axis, *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Size of the measurement; channels first where the PSF fixes their number."""
        return (*self._channel_axis, *self.sensor)

    def embed(self, scene: Tensor) -> Tensor:
        """Scene on the whole period, zero outside the support."""
        return _embed(scene, self.geometry.scene, self.geometry.period)

    def _forward(self, v: Tensor) -> Tensor:
        return self._moved(v, self.geometry.scene, self.transfer, self.geometry.sensor)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self._moved(y, self.geometry.sensor, self.transfer.conj(), self.geometry.scene)

    def _moved(self, inside: Tensor, window: Window, transfer: Tensor, wanted: Window) -> Tensor:
        """A window of the period, blurred, in another window of it."""
        spectrum = rfft2_window(inside, window[:2], self.geometry.period)
        channels_alike = spectrum.ndim >= transfer.ndim and spectrum.shape[-3] >= transfer.shape[0]
        spectrum = spectrum.mul_(transfer) if channels_alike else spectrum * transfer
        return irfft2_window_(spectrum, wanted, self.geometry.period)


def _embed(small: Tensor, window: Window, period: tuple[int, int]) -> Tensor:
    top, left, height, width = window
    large = small.new_zeros((*small.shape[:-2], *period))
    large[..., top : top + height, left : left + width] = small
    return large
