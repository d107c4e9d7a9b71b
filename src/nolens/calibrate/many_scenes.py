"""Measurements of many scenes, as a linear map of the PSF they have in common."""

from torch import Tensor

from nolens.kernels import irfft2, rfft2
from nolens.operators import CroppedConvolution, Region


class ManyScenes(CroppedConvolution):
    r"""Measurements of many scenes, as a linear map of the PSF they have in common.

    b_k[i] = Σ_o p[o] x_k[i − o], i on the sensor, o the PSF's cells counted from its middle
    (rows // 2, columns // 2): `CroppedConvolution` with its two factors exchanged, so that light
    which falls beside the sensor is not mistaken for none (`uvimprint`, eq. 6).

    Parameters
    ----------
    scenes
        (measurements, rows, columns).
    region
        Where their cells lie in the sensor's frame.
    sensor
        (rows, columns) of the measurements.
    psf
        (rows, columns) of the PSF.
    """

    def __init__(
        self, scenes: Tensor, region: Region, sensor: tuple[int, int], psf: tuple[int, int]
    ) -> None:
        rows, columns = scenes.shape[-2:]
        window = Region(
            region.top + rows // 2 - psf[0] // 2, region.left + columns // 2 - psf[1] // 2, *psf
        )
        super().__init__(scenes, sensor, window)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the PSF."""
        return self.geometry.scene[2:]

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Measurements of all scenes."""
        return (self.channels, *self.sensor)

    def _forward(self, v: Tensor) -> Tensor:
        image = irfft2(rfft2(self.embed(v))[..., None, :, :] * self.transfer, self.geometry.period)
        top, left, height, width = self.geometry.sensor
        return image[..., top : top + height, left : left + width]

    def _adjoint(self, y: Tensor) -> Tensor:
        top, left, height, width = self.geometry.sensor
        period = y.new_zeros((*y.shape[:-2], *self.geometry.period))
        period[..., top : top + height, left : left + width] = y
        back = irfft2((rfft2(period) * self.transfer.conj()).sum(dim=-3), self.geometry.period)
        top, left, height, width = self.geometry.scene
        return back[..., top : top + height, left : left + width]
