r"""Where a measurement asks for light that a scene does not have.

What is left of the measurement, :math:`r`, is correlated with the PSF at every pixel outside. With
:math:`a_s` what a light at pixel s puts on the sensor, and white noise of standard deviation σ,

.. math:: z_s = \frac{\langle a_s, r \rangle}{\sigma \|a_s\|}

is the light's signal-to-noise ratio (matched filter, `turin1960`): a normal number where no light
comes from.

Residual and PSF are taken without their local means, as in `nolens.solvers.held_out`: the glow of a
scene is what a few iterations are late with, and says little of where the light comes from.
"""

import math

import torch
import torch.nn.functional as nnf
from scipy import ndimage
from torch import Tensor

from nolens.operators import CroppedConvolution, PixelRectangle
from nolens.solvers.held_out import PartialFit, box_mean, channel_noise, local_mean
from nolens.solvers.problem import Problem

DETAIL_SIDE = 7
"""Pixels along the squares in which detail is summed."""
_MOST_DETAIL = 0.995
"""Quantile that is the most."""
_APART = 0.04
"""Of the frame's shorter side, twice which lies between parts of a scene that are apart."""
_SPARSE = 0.4
"""Fraction of the largest that it is at least, where there is light on fewer pixels."""
_ALIKE, _PEAK = 0.2, 10
"""Autocorrelation of a PSF from which on its mask repeats itself, and pixels each way around no
shift, where it is that of the PSF's lines."""
CLEAR = 5.5
"""Signal-to-noise ratio of light beside the rectangle; of 10⁵ normal numbers the largest is 4.3."""
CLEAR_AFAR = 8.0
"""The same of light far from it: what a PSF leaves unexplained has longer tails."""
_SIDES = (1, 5)
"""Pixels along the squares of light that are looked for."""
_STRONG = 0.3
"""Fraction of the clearest signal from which on others count: side lobes are weaker."""
_GROWTH = 0.25
"""Of the rectangle's sides, by which it grows at most at once, to either side."""
_GROWTH_AT_LEAST = 4
_SEEN = 0.05
"""Of the most that a pixel's light puts on the sensor, below which it is not looked for."""


class Light:
    """Where a measurement asks for light, in the pixels of the scene without a limit."""

    def __init__(self, full: Problem, psf: Tensor) -> None:
        self._full = full
        self.scene = PixelRectangle(*full.forward.geometry.origin, *full.scene_shape[1:])
        noise = channel_noise(full)
        self._weight = noise.square().reciprocal()[:, None, None]
        detail = (psf - local_mean(psf, torch.ones_like(psf, dtype=torch.bool))) / full.psf_norm
        self._correlation = CroppedConvolution(detail, full.forward.sensor, full.forward.support)
        self._lengths = [self._length(detail, side) for side in _SIDES]
        self._seen = self._lengths[0] > _SEEN * self._lengths[0].max()
        self._alike = _autocorrelation(detail)
        self.has_ghosts = bool((self._alike > _ALIKE).any())

    def _length(self, detail: Tensor, side: int) -> Tensor:
        """‖a_s‖/σ of a square of light around each pixel."""
        square = _sums(detail, side).square()
        forward = self._full.forward
        power = CroppedConvolution(square, forward.sensor, forward.support)
        seen = power.adjoint(self._full.valid.to(detail.dtype)) * self._weight
        return seen.sum(0).clamp_min(0).sqrt()

    def _signals(self, residual: Tensor, fitted: Tensor) -> Tensor:
        """Signal-to-noise ratios, (squares, height, width)."""
        detail = torch.where(fitted, residual - local_mean(residual, fitted), 0)
        sums = (self._correlation.adjoint(detail) * self._weight).sum(0)
        signals = []
        for side, length in zip(_SIDES, self._lengths, strict=True):
            seen = length > _SEEN * length.max()
            signals.append(torch.where(seen, _sums(sums[None], side)[0] / length, 0))
        return torch.stack(signals)

    def most_detail(self, scene: Tensor) -> float:
        """Detail of a scene without a limit where it has most."""
        density = torch.where(self._seen, _detail(scene), 0).flatten()
        usual = density.kthvalue(math.ceil(_MOST_DETAIL * len(density))).values
        return max(float(usual), _SPARSE * float(density.max()))

    def with_detail(self, support: PixelRectangle, scene: Tensor, least: float) -> PixelRectangle:
        """The part of a scene that has so much detail, or all of it where none has."""
        density = torch.zeros_like(self._seen, dtype=scene.dtype)
        density[self._slices(support)] = _detail(scene)
        wanted = self._seen & (density >= least)
        return self._around(wanted) if bool(wanted.any()) else support

    def main_part(self, support: PixelRectangle, scene: Tensor, least: float) -> PixelRectangle:
        """The rectangle around the part that has most detail, of parts that lie apart."""
        inside = self._slices(support)
        density = torch.zeros_like(self._seen, dtype=scene.dtype)
        density[inside] = _detail(scene)
        density[~self._seen | (density < least)] = 0
        reach = 2 * max(1, round(_APART * min(self._full.forward.sensor))) + 1
        joined = nnf.max_pool2d(density[None], reach, 1, reach // 2)[0] > 0
        numbers, count = ndimage.label(joined.cpu().numpy())
        if count < 2:
            return support
        number = torch.from_numpy(numbers).long().to(density.device)
        sums = torch.bincount(number.flatten(), density.flatten())
        return self._around((density > 0) & (number == int(sums[1:].argmax()) + 1))

    def repeats(self, support: PixelRectangle, place: PixelRectangle) -> bool:
        """Whether light of one has a ghost at the other, as the PSF is alike a shift on."""
        middle = self._alike.shape[-2] // 2, self._alike.shape[-1] // 2
        rows = _shifts(support.top, support.height, place.top, place.height)
        columns = _shifts(support.left, support.width, place.left, place.width)
        least, most = zip(rows, columns, strict=True)
        top, left = (max(0, half + first) for half, first in zip(middle, least, strict=True))
        bottom, right = (max(0, half + last + 1) for half, last in zip(middle, most, strict=True))
        return bool((self._alike[top:bottom, left:right] > _ALIKE).any())

    def signal(self, problem: Problem, confined: PartialFit, support: PixelRectangle) -> Tensor:
        """The clearest signal of each pixel outside, over what is usual there, (height, width).

        A PSF that is not exactly the measurement's leaves more than noise, everywhere.
        """
        signals = self._signals(problem.residual(confined.scene), confined.fitted)
        inside = torch.zeros_like(signals[0], dtype=torch.bool)
        inside[self._slices(support)] = True
        for each in signals:
            each[inside] = 0
            usual = each[each != 0].abs()
            if usual.numel():
                each /= max(1.0, float(usual.median()) / 0.6745)
        return signals.amax(0)

    def place(
        self, support: PixelRectangle, outside: Tensor, clear_afar: float
    ) -> PixelRectangle | None:
        """Where clear signals are: near the rectangle, or else far from it; None without any."""
        near = torch.zeros_like(outside)
        beside = self._slices(with_margin(support, _GROWTH, _GROWTH_AT_LEAST))
        near[beside] = outside[beside]
        if float(near.max()) >= CLEAR:
            wanted = near >= max(CLEAR, _STRONG * float(near.max()))
        elif float(outside.max()) >= clear_afar:
            wanted = outside == outside.max()
        else:
            return None
        return self._around(wanted)

    def clearest(self, support: PixelRectangle, outside: Tensor) -> float:
        """The clearest of signals beside a rectangle, of those that are in another."""
        return float(outside[self._slices(support)].max())

    def _around(self, wanted: Tensor) -> PixelRectangle:
        """The smallest rectangle that holds pixels."""
        rows, columns = wanted.any(1).nonzero(), wanted.any(0).nonzero()
        top, left = int(rows[0]), int(columns[0])
        return PixelRectangle(
            self.scene.top + top,
            self.scene.left + left,
            int(rows[-1]) + 1 - top,
            int(columns[-1]) + 1 - left,
        )

    def visible(self, support: PixelRectangle) -> PixelRectangle:
        """The part of it that the sensor can see."""
        rows, columns = self._slices(support)
        at = self.scene
        return PixelRectangle(
            at.top + rows.start,
            at.left + columns.start,
            rows.stop - rows.start,
            columns.stop - columns.start,
        )

    def fraction(self, support: PixelRectangle) -> float:
        """Fraction of the pixels that can be seen."""
        part = self.visible(support)
        return part.height * part.width / (self.scene.height * self.scene.width)

    def _slices(self, support: PixelRectangle) -> tuple[slice, slice]:
        at = self.scene
        top, left = max(0, support.top - at.top), max(0, support.left - at.left)
        bottom = min(at.height, support.top + support.height - at.top)
        right = min(at.width, support.left + support.width - at.left)
        return slice(top, max(top, bottom)), slice(left, max(left, right))


def with_margin(support: PixelRectangle, by: float, least: int) -> PixelRectangle:
    """With a share of its sides around it, and at least so many pixels."""
    rows, columns = (max(least, math.ceil(by * side)) for side in (support.height, support.width))
    return PixelRectangle(
        support.top - rows,
        support.left - columns,
        support.height + 2 * rows,
        support.width + 2 * columns,
    )


def _shifts(first: int, size: int, other: int, other_size: int) -> tuple[int, int]:
    """The least and the greatest shift from a line of the first part to a line of the other."""
    return other - (first + size - 1), other + other_size - 1 - first


def _autocorrelation(detail: Tensor) -> Tensor:
    """Of all channels, over that of no shift, which is in the middle; zero around there."""
    height, width = (2 * side for side in detail.shape[-2:])
    power = torch.fft.rfft2(detail, s=(height, width)).abs().square().sum(0)
    alike: Tensor = torch.fft.fftshift(torch.fft.irfft2(power, s=(height, width)))
    row, column = height // 2, width // 2
    alike = alike / alike[row, column]
    top, left = max(0, row - _PEAK), max(0, column - _PEAK)
    alike[top : row + _PEAK + 1, left : column + _PEAK + 1] = 0
    return alike


def _sums(plane: Tensor, side: int) -> Tensor:
    """Sums over side×side pixels around each."""
    if side == 1:
        return plane
    return box_mean(plane, side) * side**2


def _detail(scene: Tensor) -> Tensor:
    """Total variation in squares around each pixel, of all channels."""
    down, right = scene.diff(dim=-2).abs(), scene.diff(dim=-1).abs()
    steps = nnf.pad(down, (0, 0, 0, 1)) + nnf.pad(right, (0, 1))
    return _sums(steps, DETAIL_SIDE).sum(0)
