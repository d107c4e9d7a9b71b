"""Measurements of known scenes: as a linear map of their common PSF, and how much each says."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera.frame import size_text
from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2
from nolens.operators import CroppedConvolution, PixelRectangle

_MODEL_ERROR = 0.1
_FADED = 8
_BANDS = 24
_NOISE_FROM = 0.45


@dataclass(frozen=True)
class KnownScenes:
    """Measurements of scenes that are known; each channel of each pair is one of them.

    Attributes
    ----------
    scenes
        Radiance on the scene's pixels, (measurements, rows, columns), not negative.
    measured
        Linear values with 0 for no light, (measurements, rows, columns) of the sensor.
    valid
        bool, like `measured`: False where a pixel is saturated.
    support
        Where the scenes' pixels lie in the sensor's frame.
    """

    scenes: Tensor
    measured: Tensor
    valid: Tensor
    support: PixelRectangle

    @classmethod
    def of(
        cls,
        scenes: Sequence[Tensor],
        measured: Sequence[Tensor],
        valid: Sequence[Tensor] | None = None,
        support: PixelRectangle | None = None,
        names: Sequence[tuple[str, str]] | None = None,
    ) -> Self:
        """Put pairs together, each of one or more channels.

        Parameters
        ----------
        scenes, measured, valid
            (channels, rows, columns) of each pair; without `valid` every pixel is.
        support
            None for scenes in the middle of the sensor's frame.
        names
            Of the scene and the measurement of each pair, for messages.

        Raises
        ------
        DataError
            If there is none, sizes do not fit together, or one shows nothing.
        """
        if not scenes or len(scenes) != len(measured):
            raise DataError(
                f"{len(scenes)} scenes and {len(measured)} measurements: give one of each, or more"
            )
        if valid is None:
            valid = [torch.ones_like(each, dtype=torch.bool) for each in measured]
        names = names or [("a scene", "a measurement")] * len(scenes)
        for one, other, both in zip(scenes, measured, names, strict=True):
            for name, first_name, each, first in (
                (both[0], names[0][0], one, scenes[0]),
                (both[1], names[0][1], other, measured[0]),
            ):
                if each.shape[-2:] != first.shape[-2:]:
                    raise DataError(
                        f"{name} has {size_text(each)} pixels, but {first_name} "
                        f"{size_text(first)}: the sizes of all must be the same, pixel by pixel"
                    )
                _check_light(each, name)
            if one.shape[0] != other.shape[0]:
                raise DataError(
                    f"{both[0]} has {one.shape[0]} channels and {both[1]} {other.shape[0]}"
                )
        rows, columns = scenes[0].shape[-2:]
        sensor = (measured[0].shape[-2], measured[0].shape[-1])
        if support is None:
            support = PixelRectangle.centred(rows, columns, sensor)
        if (support.height, support.width) != (rows, columns):
            raise DataError(
                f"the support has {support.height}×{support.width} pixels and {names[0][0]} "
                f"{rows}×{columns}: it says where the pictures lie, pixel by pixel"
            )
        return cls(
            torch.cat([each.float() for each in scenes]),
            torch.cat([each.float() for each in measured]),
            torch.cat(list(valid)),
            support,
        )

    def only(self, rows: list[int]) -> Self:
        """Some of the measurements."""
        return replace(
            self, scenes=self.scenes[rows], measured=self.measured[rows], valid=self.valid[rows]
        )

    @property
    def sensor(self) -> tuple[int, int]:
        """(rows, columns) of the measurements."""
        return self.measured.shape[-2], self.measured.shape[-1]

    @property
    def extent(self) -> tuple[int, int]:
        """(rows, columns) of the PSF that light from every scene pixel to every pixel needs."""
        rows, columns = self.sensor
        return rows + self.support.height, columns + self.support.width

    def binned(self, by: int) -> Self:
        """The same on pixels binned by × by; what does not fill one is dropped at the far edges."""
        if by == 1:
            return self
        # Scene pixels are binned from the sensor's first pixel, so that both grids stay together.
        top, left = self.support.top, self.support.left
        skipped = -top % by, -left % by
        scenes = self.scenes[:, skipped[0] :, skipped[1] :]
        dark = nnf.max_pool2d((~self.valid).float()[None], by)[0] > 0
        scenes = nnf.avg_pool2d(scenes[None], by)[0]
        support = PixelRectangle(
            (top + skipped[0]) // by, (left + skipped[1]) // by, scenes.shape[-2], scenes.shape[-1]
        )
        return replace(
            self,
            scenes=scenes,
            measured=nnf.avg_pool2d(self.measured[None], by)[0],
            valid=~dark,
            support=support,
        )


def _check_light(values: Tensor, name: str) -> None:
    """Refuse what is not finite, and what is dark or the same everywhere in a channel."""
    if not bool(torch.isfinite(values).all()):
        raise DataError(f"{name} holds NaN or infinity; give finite values")
    if not bool((values.double().mean(dim=(-2, -1)) > 0).all()):
        raise DataError(
            f"{name} is dark in at least one channel, and nothing can be learnt from it: leave "
            "the pair out, or check the exposure and the black level (--black)"
        )
    if bool((values.flatten(-2).amax(dim=-1) == values.flatten(-2).amin(dim=-1)).any()):
        raise DataError(
            f"{name} is the same everywhere in at least one channel, and nothing can be learnt "
            "from it: leave the pair out, and take pictures with much detail"
        )


class ManyScenes(CroppedConvolution):
    r"""Measurements of many scenes, as a linear map of the PSF they have in common.

    b_k[i] = Σ_o p[o] x_k[i − o], i on the sensor, o the PSF's pixels counted from its middle
    (rows // 2, columns // 2): `CroppedConvolution` with its two factors exchanged, so that light
    which falls beside the sensor is not taken for none (`uvimprint`, eq. 6). A PSF that changes
    over the scene is Σ_j φ_j[s] p_j at the scene's pixel s:
    b_k[i] = Σ_j Σ_o p_j[o] φ_j[i − o] x_k[i − o].

    Parameters
    ----------
    scenes
        (measurements, rows, columns).
    support
        Where their pixels lie in the sensor's frame.
    sensor
        (rows, columns) of the measurements.
    psf
        (rows, columns) of the PSF.
    terms
        φ, (terms, rows, columns) of a scene's pixels; None for one PSF everywhere.
    """

    def __init__(
        self,
        scenes: Tensor,
        support: PixelRectangle,
        sensor: tuple[int, int],
        psf: tuple[int, int],
        terms: Tensor | None = None,
    ) -> None:
        top = support.top + support.height // 2 - psf[0] // 2
        left = support.left + support.width // 2 - psf[1] // 2
        weighted = scenes if terms is None else (terms[:, None] * scenes).flatten(0, 1)
        super().__init__(weighted, sensor, PixelRectangle(top, left, *psf))
        self._size = 1 if terms is None else len(terms), len(scenes)
        self.spectra = self.transfer.reshape(*self._size, *self.transfer.shape[-2:])
        """Half spectra of φ_j x_k on the FFT grid, (terms, measurements, height, width)."""

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """A PSF for each term."""
        return (self._size[0], *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Measurements of all scenes."""
        return (self._size[1], *self.sensor)

    def _forward(self, v: Tensor) -> Tensor:
        top, left, height, width = self.geometry.sensor
        spectrum = (rfft2(self.embed(v))[..., None, :, :] * self.spectra).sum(dim=-4)
        image = irfft2(spectrum, self.geometry.padded)
        return image[..., top : top + height, left : left + width]

    def _adjoint(self, y: Tensor) -> Tensor:
        top, left, height, width = self.geometry.sensor
        grid = y.new_zeros((*y.shape[:-2], *self.geometry.padded))
        grid[..., top : top + height, left : left + width] = y
        spectrum = (rfft2(grid)[..., None, :, :, :] * self.spectra.conj()).sum(dim=-3)
        top, left, height, width = self.geometry.scene
        return irfft2(spectrum, self.geometry.padded)[..., top : top + height, left : left + width]


def over_the_field(known: KnownScenes) -> Tensor:
    """1, and how a PSF changes over a scene: φ of `ManyScenes`, (4, rows, columns).

    With u and v the place along rows and columns, from −1 to 1 along the longer side: 1, u, v and
    u² + v², the field dependence of a camera's aberrations to second order (`welford1986`). All
    but the first are 0 in the mean over the scenes' light, so that its PSF is the mean one.
    """
    rows, columns = known.scenes.shape[-2:]
    half = max(rows, columns) / 2
    u = ((torch.arange(rows) + 0.5 - rows / 2) / half)[:, None].expand(rows, columns)
    v = ((torch.arange(columns) + 0.5 - columns / 2) / half)[None].expand(rows, columns)
    light = (known.scenes / known.scenes.mean(dim=(-2, -1), keepdim=True)).mean(dim=0)
    changing = torch.stack([u, v, u.square() + v.square()])
    changing -= (changing * light).mean(dim=(-2, -1), keepdim=True) / light.mean()
    return torch.cat([torch.ones(1, rows, columns), changing])


@dataclass(frozen=True)
class Weights:
    r"""Inverse covariance of what a measurement is off: W = T F* (1/P) F T.

    Noise is white; what the model leaves out (light that comes aslant, misregistration, light from
    beside the picture) is not: it is a small fraction of the light where there is much, at low
    spatial frequencies, and a large one where there is little. So P(f) = N + ε √(S(f) S₀), with
    the power S of the measurements by spatial frequency, S₀ its largest, the noise N at the
    highest frequencies, and ε a tenth: generalised least squares (`aitken1936`). Without it, ten
    low frequencies outweigh all of the PSF. T fades out towards the sensor's edges and is zero
    where a pixel is saturated.

    Attributes
    ----------
    taper
        T, (measurements, rows, columns).
    frequencies
        Mean of each band, in cycles per pixel.
    expected
        P, (measurements, bands).
    spectrum
        1/P on the half spectrum of the sensor, (measurements, rows, columns // 2 + 1).
    """

    taper: Tensor
    frequencies: Tensor
    expected: Tensor
    spectrum: Tensor

    @classmethod
    def of(cls, measured: Tensor, valid: Tensor) -> Self:
        """Find them of measurements of the same mean, (measurements, rows, columns)."""
        rows, columns = measured.shape[-2:]
        taper = torch.outer(_faded(rows), _faded(columns)) * valid
        frequency = _frequency(rows, columns)
        edges = torch.logspace(math.log10(0.75 / min(rows, columns)), math.log10(0.75), _BANDS)
        band = torch.bucketize(frequency, edges).flatten()
        filled = torch.bincount(band) > 0
        bands = (filled.cumsum(0) - 1)[band]
        count = torch.bincount(bands)
        middle = torch.bincount(bands, frequency.flatten()) / count
        spectrum = rfft2(measured * taper).abs().square()
        spectrum /= taper.square().sum(dim=(-2, -1), keepdim=True)
        power = torch.stack([torch.bincount(bands, each.flatten()) / count for each in spectrum])
        noise = power[:, middle >= _NOISE_FROM].amin(dim=1, keepdim=True)
        mean = power.mean(dim=0)
        expected = noise + _MODEL_ERROR * (mean * mean.max()).sqrt()
        return cls(taper, middle, expected, _spread(1 / expected, middle, frequency))

    def __call__(self, values: Tensor) -> Tensor:
        """Apply W to (measurements, rows, columns)."""
        spectrum = rfft2(values * self.taper) * self.spectrum
        return self.taper * irfft2(spectrum, (values.shape[-2], values.shape[-1]))

    def product(self, one: Tensor, other: Tensor) -> Tensor:
        """⟨one, W other⟩ of each measurement, (measurements, 1, 1), float64."""
        return (one.double() * self(other)).sum(dim=(-2, -1), keepdim=True)

    def on_grid(self, grid: tuple[int, int]) -> Tensor:
        """T² F* (1/P) F in the mean, on the half spectrum of a grid that holds the sensor."""
        fraction = self.taper.square().sum(dim=(-2, -1), keepdim=True) / (grid[0] * grid[1])
        return fraction * _spread(1 / self.expected, self.frequencies, _frequency(*grid))


def _faded(length: int) -> Tensor:
    """1, but for both ends, which rise as sin² over an eighth of the length."""
    edge = max(1, length // _FADED)
    rise = torch.sin((torch.arange(edge) + 0.5) / edge * (math.pi / 2)).square()
    return torch.cat([rise, torch.ones(length - 2 * edge), rise.flip(0)])


def _frequency(rows: int, columns: int) -> Tensor:
    """Cycles to the pixel, on a half spectrum."""
    return torch.hypot(torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns)[None])


def _spread(values: Tensor, at: Tensor, frequency: Tensor) -> Tensor:
    """Values of bands at any frequency: straight lines between their logarithms."""
    least = float(at[at > 0].min()) / 2
    target, known = (np.log(each.clamp_min(least).numpy()) for each in (frequency, at))
    planes = [np.exp(np.interp(target, known, np.log(each.numpy()))) for each in values]
    return torch.from_numpy(np.stack(planes)).to(values.dtype)
