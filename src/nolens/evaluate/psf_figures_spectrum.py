"""How much of a pattern's light varies at each spatial frequency, and how much of that is noise."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import rfft2

DIRECTIONS_DEG = (0, 90, 180, 270)
"""Directions along which the magnitude is told: to the right, up, to the left and down."""
_WEDGE_DEG = 10.0
_RING = 0.0025
_NOISE_RING = 0.02
_HIGHEST = 0.5
"""Cycles to the cell: half width of a direction, width of a ring, the same for noise, the limit."""
_CROSS, _NEAR = 2, 16
"""Steps of the transform from an axis that are left out, and from zero up to which they are not."""
_BLOCK = 3
_DARKEST = 0.01
_DEVIATIONS = 2.33
"""Sides of the means, the share of them that is darker than the background, and how many standard
deviations below its mean a normal distribution has that share."""


@dataclass(frozen=True)
class Spectrum:
    """Power of a pattern without its mean, by spatial frequency.

    Parameters
    ----------
    power
        |F|² of the pattern less its mean, half of the plane, float64.
    down, right
        Frequencies along rows and columns, cycles to the cell.
    shape
        Rows and columns of the pattern.
    noise_power
        |F|² of white noise on every cell.
    background
        Level that the pattern stands on, see `background_of`.
    total
        Sum of the pattern without that.
    """

    power: Tensor
    down: Tensor
    right: Tensor
    shape: tuple[int, int]
    noise_power: float
    background: float = 0.0
    total: float = 1.0

    @classmethod
    def of(cls, pattern: Tensor, noise: float | None) -> "Spectrum":
        """Transform a pattern (rows, columns).

        Parameters
        ----------
        pattern
            In any unit.
        noise
            Standard deviation of every cell's noise; None takes the power that is left at the
            frequencies, up to half a cycle to the cell, where it is least: rings of 0.02 cycles,
            the lowest of them. Patterns with details finer than two cells have power there too,
            which counts as noise.
        """
        rows, columns = pattern.shape
        shape, values = (rows, columns), pattern.double()
        power = rfft2((values - values.mean()).contiguous()).abs().square()
        down = torch.fft.fftfreq(rows, dtype=torch.float64)
        right = torch.fft.rfftfreq(columns, dtype=torch.float64)
        spectrum = cls(power, down, right, shape, 0.0)
        if noise is None:
            floor = spectrum._rings(_NOISE_RING, None)[1].min()
        else:
            floor = torch.tensor(noise**2 * rows * columns)
        background = background_of(pattern, math.sqrt(float(floor) / (rows * columns)))
        total = float((values - background).sum())
        return cls(power, down, right, shape, float(floor), background, total)

    @property
    def cells(self) -> int:
        """Number of cells of the pattern."""
        return self.shape[0] * self.shape[1]

    @property
    def noise(self) -> float:
        """Standard deviation of every cell's noise, in the pattern's unit."""
        return math.sqrt(self.noise_power / self.cells)

    @property
    def radius(self) -> Tensor:
        """Length of every frequency."""
        return torch.hypot(self.down[:, None], self.right)

    @property
    def weight(self) -> Tensor:
        """How often every column stands in the whole plane."""
        return column_weights(self.shape[1])

    def magnitude(self, direction_deg: int | None = None) -> tuple[Tensor, Tensor]:
        r"""Frequencies and spectral magnitude :math:`\sqrt{\langle|F|^2\rangle - N}\,/\,F_0`.

        Over rings of 0.0025 cycles to the cell (or two steps of the transform, where that is
        more), without the noise's power N; :math:`F_0` is the pattern's light without its
        background. It is the root mean square over many spots in random places: n of them have
        :math:`1/\sqrt n` of what one has, so it is no modulation transfer.

        Parameters
        ----------
        direction_deg
            Only what lies within 10° of this direction, but for the axis itself, on which the
            frame's edges show; None takes all.
        """
        at, power, _ = self._rings(_RING, direction_deg)
        return at, (power - self.noise_power).clamp_min(0).sqrt() / self.total

    def clear_bands(self) -> tuple[tuple[float, float], ...]:
        """Frequencies, from and to, at which the pattern has more power than noise.

        In cycles to the cell. At their ends Wiener's filter gives half of what it passes
        (`wiener1949`). Gaps and bands of less than 0.02 cycles are passed over.
        """
        at, power, _ = self._rings(_RING, None)
        clear = power >= 2 * self.noise_power
        for value in (False, True):
            for first, last in _runs(clear, value=value):
                ends = first == 0 if value else last == len(at) - 1
                if float(at[last] - at[first]) < _NOISE_RING and not ends:
                    clear[first : last + 1] = not value
        edges = [float(each) for each in at]
        edges[0], edges[-1] = 0.0, _HIGHEST
        return tuple((edges[first], edges[last]) for first, last in _runs(clear, value=True))

    def _rings(self, width: float, direction_deg: int | None) -> tuple[Tensor, Tensor, Tensor]:
        """Mean frequency, mean power and number of values of rings that hold any."""
        width = max(width, 2 / min(self.shape))
        radius = self.radius
        inside = (radius > 0) & (radius <= _HIGHEST)
        if direction_deg is not None:
            angle = torch.atan2(-self.down[:, None], self.right) * (180 / math.pi)
            # F(-f) is the conjugate of F(f): half of the plane has every direction, modulo 180°.
            off = (angle - direction_deg + 90).remainder(180) - 90
            inside &= off.abs() <= _WEDGE_DEG
            # Frames that do not continue at their edges have a cross of light in their spectrum.
            steps = (self.down[:, None] * self.shape[0], self.right * self.shape[1])
            beside = (steps[0].abs() >= _CROSS) & (steps[1].abs() >= _CROSS)
            inside &= beside | (torch.hypot(*steps) < _NEAR)
        radius, power = radius[inside], (self.power * self.weight)[inside]
        weight = self.weight.expand_as(self.power)[inside]
        # What is left over beyond the last whole ring counts to that.
        last = max(1, round(_HIGHEST / width)) - 1
        ring = (radius / width).long().clamp(max=last)
        count = torch.zeros(last + 1, dtype=torch.float64)
        sums = [count.clone().index_add_(0, ring, each) for each in (radius * weight, power)]
        count.index_add_(0, ring, weight)
        held = count > 0
        return sums[0][held] / count[held], sums[1][held] / count[held], count[held]


def _runs(clear: Tensor, *, value: bool) -> list[tuple[int, int]]:
    """First and last place of every run of a value."""
    places: list[tuple[int, int]] = []
    for place, each in enumerate(clear.tolist()):
        if each != value:
            continue
        if places and places[-1][1] == place - 1:
            places[-1] = places[-1][0], place
        else:
            places.append((place, place))
    return places


def column_weights(columns: int) -> Tensor:
    """How often every column of a half spectrum stands in the whole one."""
    weight = torch.full((columns // 2 + 1,), 2.0, dtype=torch.float64)
    weight[0] = 1.0
    if columns % 2 == 0:
        weight[-1] = 1.0
    return weight


def background_of(pattern: Tensor, noise: float) -> float:
    """Level that the pattern stands on: 1 % of its 3×3 means are darker, but for the noise.

    Parameters
    ----------
    pattern
        (rows, columns), at least 3 of each.
    noise
        Standard deviation of every cell's. Of a dark area that has it, 1 % of the 3×3 means are
        darker by 2.33 thirds of it, which are added.
    """
    means = torch.nn.functional.avg_pool2d(pattern[None, None].double(), _BLOCK, 1).flatten()
    darkest = float(means.sort().values[int(_DARKEST * (len(means) - 1))])
    return darkest + _DEVIATIONS * noise / _BLOCK
