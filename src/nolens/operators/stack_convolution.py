"""The forward model of several scenes on one sensor: depths, bands, or instants."""

from collections.abc import Sequence

from torch import Tensor

from nolens.errors import OptionError
from nolens.kernels import irfft2_window_, rfft2_window
from nolens.operators.base import LinearOperator
from nolens.operators.convolution import CroppedConvolution


class StackConvolution(LinearOperator):
    r"""One measurement of a stack of scenes, each with its PSF and its mask on the sensor.

    .. math:: b = C \sum_k m_k ⊙ (h_k * v_k)

    The slices :math:`v_k` are planes at several depths (`antipa2018`), bands of wavelengths behind
    filters (`monakhova2020`), or instants of a rolling shutter (`antipa2019`). The masks
    :math:`m_k` are what each sensor pixel takes of slice k. PSFs of a slice may vary over the
    field (`FieldConvolution`). Slices without masks are summed in the Fourier domain.

    Parameters
    ----------
    operators
        One for each slice, or one for all; of one sensor, support and size of PSF.
    masks
        ``(slices, rows, columns)`` of the sensor, or ``(slices, channels, rows, columns)``; None
        where all pixels take all of every slice, of which there is then one for each operator.

    Raises
    ------
    OptionError
        If operators do not fit one another, or masks do not fit them.

    Notes
    -----
    Takes ``(..., slices, height, width)``, gives ``(..., rows, columns)``; with channels where the
    PSFs fix their number: ``(..., channels, slices, height, width)``.
    """

    def __init__(
        self, operators: Sequence[CroppedConvolution], masks: Tensor | None = None
    ) -> None:
        geometries = {each.geometry for each in operators}
        if len(geometries) != 1:
            raise OptionError(
                f"a stack has {len(operators)} operators of {len(geometries)} geometries: give "
                "PSFs of one size, with one sensor and one support"
            )
        (self.geometry,) = geometries
        count = len(operators) if masks is None else len(masks)
        first = operators[0]
        fits = {(count, *first.sensor), (count, first.channels, *first.sensor)}
        if len(operators) not in (1, count) or (
            masks is not None and tuple(masks.shape) not in fits
        ):
            raise OptionError(
                f"a stack has {len(operators)} operators for a sensor of {first.sensor}, and masks "
                f"of {None if masks is None else tuple(masks.shape)}: give one mask of the "
                "sensor's size for each slice, and one operator for each or one for all"
            )
        if len({each.channels for each in operators}) > 1:
            raise OptionError("PSFs of a stack have different numbers of channels: give one number")
        self.operators = tuple(operators) * (count if len(operators) == 1 else 1)
        self.masks = masks
        self.sensor, self.support, self.channels = first.sensor, first.support, first.channels
        self._rows = [slice(0, self.sensor[0])] * count
        if masks is not None:
            self._rows = [_rows_with_light(mask) for mask in masks]

    def scale_(self, factor: Tensor) -> None:
        """Multiply the PSFs of all slices by a factor, in place."""
        for each in set(self.operators):
            each.scale_(factor)

    @property
    def slices(self) -> int:
        """How many scenes it takes."""
        return len(self.operators)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Slices, and size of each; channels first where the PSFs fix their number."""
        lead = (self.channels,) if self.channels > 1 else ()
        return (*lead, self.slices, *self.geometry.scene[2:])

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Size of the measurement; channels first where the PSFs fix their number."""
        return ((self.channels,) if self.channels > 1 else ()) + self.sensor

    def _forward(self, v: Tensor) -> Tensor:
        geometry = self.geometry
        if self.masks is None:
            spectrum = self.operators[0].light_spectrum(self._slice(v, 0))
            for number, operator in enumerate(self.operators[1:], start=1):
                spectrum += operator.light_spectrum(self._slice(v, number))
            return irfft2_window_(spectrum, geometry.sensor, geometry.padded)
        image = v.new_zeros((*v.shape[:-3], *self.sensor))
        for number in range(self.slices):
            self._add_image_(image, number, self._slice(v, number))
        return image

    def image_of(self, number: int, scene: Tensor) -> Tensor:
        """What the sensor sees of one slice, (..., rows, columns), from (..., height, width)."""
        image = scene.new_zeros((*scene.shape[:-2], *self.sensor))
        self._add_image_(image, number, scene)
        return image

    def _add_image_(self, image: Tensor, number: int, scene: Tensor) -> None:
        geometry, rows = self.geometry, self._rows[number]
        if rows.start == rows.stop:
            return
        top, left, _, width = geometry.sensor
        window = top + rows.start, left, rows.stop - rows.start, width
        spectrum = self.operators[number].light_spectrum(scene)
        part = irfft2_window_(spectrum, window, geometry.padded)
        image[..., rows, :] += part if self.masks is None else part * self._mask(number, part)

    def _adjoint(self, y: Tensor) -> Tensor:
        geometry = self.geometry
        top, left = geometry.sensor[:2]
        out = y.new_zeros((*y.shape[:-2], self.slices, *geometry.scene[2:]))
        spectrum = None
        for number, (operator, rows) in enumerate(zip(self.operators, self._rows, strict=True)):
            if self.masks is not None:
                if rows.start == rows.stop:
                    continue
                part = y[..., rows, :] * self._mask(number, y)
                spectrum = rfft2_window(part, (top + rows.start, left), geometry.padded)
            elif spectrum is None:
                spectrum = rfft2_window(y, (top, left), geometry.padded)
            self._slice(out, number).copy_(operator.scene_of(spectrum))
        return out

    def _slice(self, stack: Tensor, number: int) -> Tensor:
        """A view of one scene, as its operator takes it."""
        return stack.select(-3, number)

    def _mask(self, number: int, like: Tensor) -> Tensor:
        assert self.masks is not None
        return self.masks[number, ..., self._rows[number], :].to(like)


def _rows_with_light(mask: Tensor) -> slice:
    """First to last row of a mask with a pixel that takes light."""
    rows = mask.flatten(0, -3).any(0).any(-1) if mask.ndim > 2 else mask.any(-1)
    lit = rows.nonzero().flatten().tolist()
    return slice(lit[0], lit[-1] + 1) if lit else slice(0, 0)
