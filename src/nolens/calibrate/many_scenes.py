"""Measurements of many scenes, as a linear map of the PSF they have in common."""

from torch import Tensor

from nolens.kernels import irfft2, rfft2
from nolens.operators import CroppedConvolution, Region


class ManyScenes(CroppedConvolution):
    r"""Measurements of many scenes, as a linear map of the PSF they have in common.

    b_k[i] = Σ_o p[o] x_k[i − o], i on the sensor, o the PSF's pixels counted from its middle
    (rows // 2, columns // 2): `CroppedConvolution` with its two factors exchanged, so that light
    which falls beside the sensor is not taken for none (`uvimprint`, eq. 6).

    Parameters
    ----------
    scenes
        (measurements, rows, columns).
    region
        Where their pixels lie in the sensor's frame.
    sensor
        (rows, columns) of the measurements.
    psf
        (rows, columns) of the PSF.
    """

    def __init__(
        self, scenes: Tensor, region: Region, sensor: tuple[int, int], psf: tuple[int, int]
    ) -> None:
        top = region.top + region.height // 2 - psf[0] // 2
        left = region.left + region.width // 2 - psf[1] // 2
        super().__init__(scenes, sensor, Region(top, left, *psf))

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the PSF."""
        return self.geometry.scene[2:]

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Measurements of all scenes."""
        return (self.channels, *self.sensor)

    def _forward(self, v: Tensor) -> Tensor:
        return self._measured(rfft2(self.embed(v))[..., None, :, :] * self.transfer)

    def _adjoint(self, y: Tensor) -> Tensor:
        return self._on_psf((self._spectrum(y) * self.transfer.conj()).sum(dim=-3))

    def _spectrum(self, y: Tensor) -> Tensor:
        """Of measurements, on the period."""
        top, left, height, width = self.geometry.sensor
        period = y.new_zeros((*y.shape[:-2], *self.geometry.period))
        period[..., top : top + height, left : left + width] = y
        return rfft2(period)

    def _measured(self, spectrum: Tensor) -> Tensor:
        """The sensor's part of what has a spectrum."""
        top, left, height, width = self.geometry.sensor
        image = irfft2(spectrum, self.geometry.period)
        return image[..., top : top + height, left : left + width]

    def _on_psf(self, spectrum: Tensor) -> Tensor:
        """The PSF's part of what has a spectrum."""
        top, left, height, width = self.geometry.scene
        back = irfft2(spectrum, self.geometry.period)
        return back[..., top : top + height, left : left + width]


class ManyScenesAslant(ManyScenes):
    r"""The same, of a PSF that changes over the scene: that of its pixel s is Σ_j φ_j[s] p_j.

    b_k[i] = Σ_j Σ_o p_j[o] φ_j[i − o] x_k[i − o].

    Parameters
    ----------
    scenes, region, sensor, psf
        As in `ManyScenes`.
    terms
        φ, (terms, rows, columns) of a scene's pixels.
    """

    def __init__(
        self,
        scenes: Tensor,
        region: Region,
        sensor: tuple[int, int],
        psf: tuple[int, int],
        terms: Tensor,
    ) -> None:
        super().__init__((terms[:, None] * scenes).flatten(0, 1), region, sensor, psf)
        self._size = len(terms), len(scenes)
        self.spectra = self.transfer.reshape(*self._size, *self.transfer.shape[-2:])
        """Half spectra of φ_j x_k on the period, (terms, measurements, height, width)."""

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """A PSF for each term."""
        return (self._size[0], *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Measurements of all scenes."""
        return (self._size[1], *self.sensor)

    def _forward(self, v: Tensor) -> Tensor:
        return self._measured((rfft2(self.embed(v))[..., None, :, :] * self.spectra).sum(dim=-4))

    def _adjoint(self, y: Tensor) -> Tensor:
        return self._on_psf(
            (self._spectrum(y)[..., None, :, :, :] * self.spectra.conj()).sum(dim=-3)
        )
