"""The forward model of a mask-based lensless camera, and the padded shape of its transforms."""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import OptionError
from nolens.kernels import fast_length, irfft2_window_, irfft2_windows_, rfft2_window
from nolens.operators.base import LinearOperator


@dataclass(frozen=True)
class PixelRectangle:
    """Rectangle of scene pixels, in the sensor's frame.

    Scene pixel (i, j) is the one whose light, through the centre of the PSF, falls on sensor
    pixel (i, j). A scene can reach beyond the sensor, so `top` and `left` may be negative.
    """

    top: int
    left: int
    height: int
    width: int

    @classmethod
    def centred(cls, height: int, width: int, sensor: tuple[int, int]) -> "PixelRectangle":
        """Support of the given size around the centre of the sensor."""
        return cls((sensor[0] - height) // 2, (sensor[1] - width) // 2, height, width)

    @property
    def bottom(self) -> int:
        """First row below it."""
        return self.top + self.height

    @property
    def right(self) -> int:
        """First column beside it."""
        return self.left + self.width

    @property
    def text(self) -> str:
        """HEIGHTxWIDTH+TOP+LEFT, as --support takes it."""
        return f"{self.height}x{self.width}{self.top:+d}{self.left:+d}"

    def finer(self, by: int) -> "PixelRectangle":
        """The same where `by`×`by` pixels stand for each of these."""
        return PixelRectangle(self.top * by, self.left * by, self.height * by, self.width * by)

    def union(self, other: "PixelRectangle") -> "PixelRectangle":
        """The smallest that holds both."""
        top, left = min(self.top, other.top), min(self.left, other.left)
        bottom, right = max(self.bottom, other.bottom), max(self.right, other.right)
        return PixelRectangle(top, left, bottom - top, right - left)

    def intersection(self, other: "PixelRectangle") -> "PixelRectangle":
        """The pixels of both; of no height or width where there are none."""
        top, left = max(self.top, other.top), max(self.left, other.left)
        height = max(0, min(self.bottom, other.bottom) - top)
        width = max(0, min(self.right, other.right) - left)
        return PixelRectangle(top, left, height, width)

    def coarser(self, by: int) -> "PixelRectangle":
        """Pixels of `by`×`by` of these that cover it, with one more around them.

        The middle of a PSF is then some of the finer pixels beside that of its coarse pixel.
        """
        top, left = self.top // by - 1, self.left // by - 1
        bottom, right = -(-self.bottom // by) + 1, -(-self.right // by) + 1
        return PixelRectangle(top, left, bottom - top, right - left)


@dataclass(frozen=True)
class _Axis:
    """`Geometry` along one axis; the PSF's pixels from `psf_start` to `psf_stop` can matter."""

    padded: int
    sensor_start: int
    scene_start: int
    scene_length: int
    psf_start: int
    psf_stop: int


@dataclass(frozen=True)
class Geometry:
    """Layout of one convolution: windows are (top, left, height, width) in the padded shape.

    Parameters
    ----------
    padded
        (height, width) of the transforms: the padded shape.
    sensor, scene
        Windows of the measurement and of the pixels that light can come from.
    psf
        Window of the PSF array that can reach the sensor from the scene.
    psf_shift
        Where the first pixel of that window lies, relative to zero shift.
    origin
        Scene pixel, in the sensor's frame, of the scene's first row and column.
    """

    padded: tuple[int, int]
    sensor: tuple[int, int, int, int]
    scene: tuple[int, int, int, int]
    psf: tuple[int, int, int, int]
    psf_shift: tuple[int, int]
    origin: tuple[int, int]

    @classmethod
    def build(
        cls, sensor: tuple[int, int], psf: tuple[int, int], support: PixelRectangle | None
    ) -> "Geometry":
        r"""Smallest fast padded shape in which no wrap-around reaches the sensor.

        For a PSF with offsets from o₀ to o₁ and scene pixels from t to t + r − 1, the shifted
        copies of the convolution miss the sensor's pixels 0 … N − 1 when the padded length is at
        least max(t + r + o₁, N − t − o₀). Offsets that carry no light from the scene to the sensor
        are cut off first, so sensor + support − 1 is enough for a support that overlaps the
        sensor, and for a scene without limits sensor + PSF − 1.

        Parameters
        ----------
        sensor, psf
            (height, width) in pixels of the same pitch. Zero shift is the PSF's pixel
            (height // 2, width // 2).
        support
            Pixels that light can come from; None for every pixel that the sensor can see, with
            the whole padded shape as the scene.

        Raises
        ------
        OptionError
            If the support has no pixel from which the PSF reaches the sensor.
        """
        if support is None:
            axes = [
                _unlimited(sensor[0], psf[0], of_rows=False),
                _unlimited(sensor[1], psf[1], of_rows=True),
            ]
            scene_origin = tuple(a.scene_start - a.sensor_start for a in axes)
        else:
            axes = [
                _confined(sensor[0], psf[0], support.top, support.height, of_rows=False),
                _confined(sensor[1], psf[1], support.left, support.width, of_rows=True),
            ]
            scene_origin = (support.top, support.left)
        rows, columns = axes
        return cls(
            padded=(rows.padded, columns.padded),
            sensor=(rows.sensor_start, columns.sensor_start, *sensor),
            scene=(
                rows.scene_start,
                columns.scene_start,
                rows.scene_length,
                columns.scene_length,
            ),
            psf=(
                rows.psf_start,
                columns.psf_start,
                rows.psf_stop - rows.psf_start,
                columns.psf_stop - columns.psf_start,
            ),
            psf_shift=(rows.psf_start - psf[0] // 2, columns.psf_start - psf[1] // 2),
            origin=(scene_origin[0], scene_origin[1]),
        )


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
    support
        Pixels that light can come from. With it, the operator takes scenes of the support's
        size; without, of the whole padded shape (`geometry.padded`), in which the sensor's frame
        lies at `geometry.sensor`.

    Raises
    ------
    OptionError
        If no light from the support reaches the sensor.
    """

    def __init__(
        self, psf: Tensor, sensor: tuple[int, int], support: PixelRectangle | None = None
    ) -> None:
        self.sensor = sensor
        self.support = support
        self.channels = psf.shape[-3]
        self._channel_axis = (self.channels,) if self.channels > 1 else ()
        self.geometry = Geometry.build(sensor, (psf.shape[-2], psf.shape[-1]), support)
        top, left, height, width = self.geometry.psf
        padded = self.geometry.padded
        self.transfer = torch.empty(
            (self.channels, padded[0], padded[1] // 2 + 1),
            dtype=psf.dtype.to_complex(),
            device=psf.device,
        )
        """Half spectrum of the PSF, (channels, height, width // 2 + 1) of the padded shape."""
        for plane, transfer in zip(psf, self.transfer, strict=True):
            part = plane[top : top + height, left : left + width]
            rfft2_window(part, self.geometry.psf_shift, padded, transfer)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the scene: the support, or the whole padded shape; channels first where fixed."""
        return (*self._channel_axis, *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Size of the measurement; channels first where the PSF fixes their number."""
        return (*self._channel_axis, *self.sensor)

    def scale_(self, factor: Tensor) -> None:
        """Multiply the PSF, every channel by its factor, in place.

        Parameters
        ----------
        factor
            `(channels, 1, 1)`.
        """
        torch.view_as_real(self.transfer).mul_(factor[..., None])

    def single(self, channel: int) -> Self:
        """That of one channel, which shares its memory."""
        single = copy(self)
        single.channels, single._channel_axis = 1, ()
        single.transfer = self.transfer[channel : channel + 1]
        return single

    def to(self, device: torch.device) -> Self:
        """The same on a device."""
        there = copy(self)
        there.transfer = self.transfer.to(device)
        return there

    @property
    def field_points(self) -> int:
        """How many PSFs it has for parts of the scene."""
        return 1

    @property
    def power(self) -> Tensor:
        """|H|² of the half spectrum, (channels, height, width // 2 + 1)."""
        return self.transfer.real.square() + self.transfer.imag.square()

    @property
    def norm_bound(self) -> float:
        """What ‖C M‖ is at most: the largest |H|."""
        return float(self.transfer.abs().max())

    def embed(self, scene: Tensor) -> Tensor:
        """Scene on the whole padded shape, zero outside the support."""
        top, left, height, width = self.geometry.scene
        padded = scene.new_zeros((*scene.shape[:-2], *self.geometry.padded))
        padded[..., top : top + height, left : left + width] = scene
        return padded

    def light_spectrum(self, v: Tensor) -> Tensor:
        """Half spectrum of Mv on the padded shape: what operators of one geometry can add up."""
        spectrum = rfft2_window(v, self.geometry.scene[:2], self.geometry.padded)
        return times_transfer_(spectrum, self.transfer)

    def scene_of(self, spectrum: Tensor) -> Tensor:
        """M*y on the scene's pixels, from the half spectrum of y, which stays as it is."""
        product = spectrum * self.transfer.conj()
        return irfft2_window_(product, self.geometry.scene, self.geometry.padded)

    def of_products(self, rows: Tensor, columns: Tensor) -> Iterator[Tensor]:
        """Measurements of the products of each row with each column; quicker than one by one.

        Parameters
        ----------
        rows, columns
            (number, height) and (number, width) of scenes.

        Yields
        ------
        Tensor
            (channels, height, width) of the sensor, those of the first row first.
        """
        geometry = self.geometry
        spectra = [
            torch.fft.fft(nnf.pad(each, (0, side - each.shape[-1])).roll(first, -1))
            for each, first, side in zip(
                (rows, columns), geometry.scene[:2], geometry.padded, strict=True
            )
        ]
        along = spectra[1][:, : geometry.padded[1] // 2 + 1]
        for row in spectra[0]:
            turned = self.transfer * row[:, None]
            yield from irfft2_windows_(turned, along, geometry.sensor, geometry.padded)

    def _forward(self, v: Tensor) -> Tensor:
        geometry = self.geometry
        return irfft2_window_(self.light_spectrum(v), geometry.sensor, geometry.padded)

    def _adjoint(self, y: Tensor) -> Tensor:
        geometry = self.geometry
        return self.scene_of(rfft2_window(y, geometry.sensor[:2], geometry.padded))


def times_transfer_(spectrum: Tensor, transfer: Tensor) -> Tensor:
    """Spectra times a transfer function, in their memory where there is one for each channel."""
    alike = spectrum.ndim >= transfer.ndim and spectrum.shape[-3] >= transfer.shape[0]
    return spectrum.mul_(transfer) if alike else spectrum * transfer


def _unlimited(sensor: int, psf: int, *, of_rows: bool) -> _Axis:
    padded = fast_length(sensor + psf - 1, of_rows=of_rows)
    return _Axis(padded, (padded - sensor) // 2, 0, padded, 0, psf)


def _confined(sensor: int, psf: int, start: int, length: int, *, of_rows: bool) -> _Axis:
    centre = psf // 2
    low = max(-centre, -(start + length - 1))
    high = min(psf - 1 - centre, sensor - 1 - start)
    if length < 1 or high < low:
        raise OptionError(
            f"no light from the support (pixels {start} to {start + length - 1} of the sensor's "
            f"frame, which has {sensor}) reaches the sensor through a PSF of {psf} pixels; "
            "give a support that overlaps the sensor"
        )
    sensor_start = max(0, -start)
    span = max(sensor_start + sensor, sensor_start + start + length)
    needed = max(start + length + high, sensor - start - low, span)
    return _Axis(
        fast_length(needed, of_rows=of_rows),
        sensor_start,
        sensor_start + start,
        length,
        low + centre,
        high + centre + 1,
    )
