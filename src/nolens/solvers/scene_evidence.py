r"""The rectangle that a scene's light most likely comes from: all of it, and nothing beside.

Of a scene in blocks, whose light is random with the covariance K inside a rectangle and zero
outside, a measurement b with white noise of standard deviation σ has the probability

.. math:: \ln p(b) = \tfrac12 a\, y^T K^{1/2} (1 + a M)^{-1} K^{1/2} y
          - \tfrac12 \ln\det(1 + a M) + \text{const}, \quad M = K^{1/2} G K^{1/2}

with :math:`G = A^T A / σ^2`, :math:`y = A^T b / σ^2` and the most likely strength a, of each
channel by itself (the evidence, `mackay1992`). What the blocks leave beyond the noise, as the model
errs, counts as noise. A rectangle that is too large expects light where there is none, and one that
is too small cannot explain what there is. In much noise, the error of held-out pixels tells the
latter alone. Dim light is less than what a larger rectangle as bright would expect: it has a
rectangle of its own, around, where K^½ is a fraction of what it is inside.
"""

import math
from collections.abc import Callable, Iterable, Iterator
from functools import cache, partial

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.operators import PixelRectangle, slow_cosines
from nolens.solvers.held_out import channel_noise
from nolens.solvers.problem import Problem

_PIXELS, _BLOCKS = 8_000, 300
"""Means of the sensor's pixels, and blocks of the scene, about."""
_CONTRAST, _LENGTH = 0.6, 0.35
"""Of a scene's light: deviation over its mean, and distance over which it is alike, over its
longer side."""
_STRENGTHS = torch.logspace(-12, 8, 81, dtype=torch.float64)
"""That are tried, over the reciprocal of the largest eigenvalue of M."""
_SLOW = 2
"""Cosines each way that do not count: the slowest light is where a model errs most."""
_RESOLVED = 1.0
"""Eigenvalue of G from which on the measurement tells the light of blocks."""
_DARK = 1e-30
"""Of that eigenvalue at least: a channel may be dark."""
_STEPS = (-2, -1, 1, 2)
"""Blocks by which two sides move outwards together."""
_DIM = 0.3
"""Of the light inside, what dim light around is expected to be. A tenth is what a model that errs
has around, too."""
_LIKELY = 8.0
"""Evidence from which on there is light, or dim light around; in noise alone it has up to 5."""
_ERRS = 1e-3
"""Of the evidence inside, that around may have more as the model errs."""

Sides = tuple[int, int, int, int]
"""First row of blocks and the one after the last, and columns."""


class Evidence:
    """The evidence of rectangles of blocks.

    Parameters
    ----------
    psf
        As `Problem.build` takes it.
    problem
        Of this PSF, without a support.
    domain
        The largest rectangle, of pixels that the sensor can see.
    """

    def __init__(self, psf: Tensor, problem: Problem, domain: PixelRectangle) -> None:
        by = max(1, round(math.sqrt(math.prod(problem.forward.sensor) / _PIXELS)))
        self.side = by * max(1, round(math.sqrt(domain.height * domain.width / _BLOCKS) / by))
        self._rows = max(1, domain.height // self.side)
        self._columns = max(1, domain.width // self.side)
        self._top = domain.top + (domain.height - self._rows * self.side) // 2
        self._left = domain.left + (domain.width - self._columns * self.side) // 2
        usable = _means(problem.valid.to(psf.dtype), by) == 1
        data = _means(torch.where(problem.valid, problem.data, 0), by)
        noise = channel_noise(problem) / by
        slow = torch.kron(*(slow_cosines(count)[:_SLOW] for count in data.shape[-2:])).to(psf)
        lights = self._lights(psf / problem.psf_norm, problem, by)
        self.excess = list[float]()
        """Mean square of what the blocks leave of each channel, over its noise's; 1 at least."""
        self._grams, self._sums = list[Tensor](), list[Tensor]()
        for channel, deviation in enumerate(noise):
            seen = usable[channel].flatten() / deviation
            basis, _ = torch.linalg.qr((slow * (seen > 0)).T)
            light = _without(basis, lights[channel % len(lights)] * seen)
            values = _without(basis, data[channel].flatten() * seen)
            gram, sums = (light @ light.T).double(), (light @ values).double()
            pixels = int((seen > 0).sum()) - len(slow)
            excess = _excess(gram, sums, float(values.double().square().sum()), pixels)
            self.excess.append(excess)
            self._grams.append(gram / excess)
            self._sums.append(sums / excess)
        numbers = torch.arange(self._rows * self._columns, device=psf.device)
        self._places = torch.stack([numbers // self._columns, numbers % self._columns], 1).double()
        self.of = cache(self._of)

    def _lights(self, psf: Tensor, problem: Problem, by: int) -> Tensor:
        """What each block puts on means of by×by of the sensor's pixels, (channels, blocks, means).

        A pixel of the scene in row r puts row i - r of the PSF, from its middle, on row i of the
        sensor.
        """
        sensor = problem.forward.sensor
        beside = [side + self.side for side in sensor]
        around = nnf.pad(psf, (beside[1], beside[1], beside[0], beside[0]))
        means = nnf.avg_pool2d(nnf.avg_pool2d(around, self.side, 1) * self.side**2, by, 1)
        rows, columns = (by * (count // by) for count in sensor)
        # Of the first block, whose last pixel's PSF begins first.
        row, column = (
            zeros + of_psf // 2 - first - (self.side - 1)
            for zeros, of_psf, first in zip(
                beside, psf.shape[-2:], (self._top, self._left), strict=True
            )
        )
        parts = [
            means[:, top : top + rows : by, left : left + columns : by].flatten(1)
            for top in range(row, row - self.side * self._rows, -self.side)
            for left in range(column, column - self.side * self._columns, -self.side)
        ]
        return torch.stack(parts, 1)

    def support(self, sides: Sides) -> PixelRectangle:
        """The pixels of a rectangle of blocks."""
        top, bottom, left, right = (self.side * side for side in sides)
        return PixelRectangle(self._top + top, self._left + left, bottom - top, right - left)

    def likeliest(self) -> Sides | None:
        """Of rectangles around the domain's middle, the one that has most, or that with dim light
        around it where some is likely; None where no rectangle is likely.
        """
        smaller = range((min(self._rows, self._columns) + 1) // 2)
        inner = self._best((self._less(k, k) for k in smaller), self.of)
        most = self.of(inner)
        if most < _LIKELY:
            return None
        of = partial(self.of, inner=inner)
        outer = self._best(self._around(inner), of, inner)
        return outer if of(outer) - most >= max(_LIKELY, _ERRS * most) else inner

    def _best(
        self, first: Iterable[Sides], of: Callable[[Sides], float], inner: Sides | None = None
    ) -> Sides:
        """From the best of some rectangles, step by step to one with none better beside it."""
        best = max(first, key=of)
        while True:
            better = max(self._beside(best, inner), key=of, default=best)
            if of(better) <= of(best):
                return best
            best = better

    def _less(self, down: int, across: int) -> Sides:
        return down, self._rows - down, across, self._columns - across

    def _around(self, inner: Sides) -> Iterator[Sides]:
        """Rectangles as much larger each way, to all of the domain."""
        down, _, across, _ = inner
        for more in range(max(down, across) + 1):
            yield self._less(max(0, down - more), max(0, across - more))

    def _beside(self, sides: Sides, inner: Sides | None) -> Iterator[Sides]:
        """Rectangles that are somewhat higher, lower, wider or narrower; with another in them."""
        down, _, across, _ = sides
        lowest, narrowest = (self._rows - 1) // 2, (self._columns - 1) // 2
        if inner is not None:
            lowest, narrowest = inner[0], inner[2]
        for step in _STEPS:
            if 0 <= down - step <= lowest:
                yield self._less(down - step, across)
            if 0 <= across - step <= narrowest:
                yield self._less(down, across - step)

    def _of(self, sides: Sides, inner: Sides | None = None) -> float:
        """Its logarithm, over that of no light at all; with dim light outside of an inner one."""
        brightest = sides if inner is None else inner
        numbers = torch.arange(len(self._places), device=self._places.device)
        blocks = numbers.view(self._rows, self._columns)
        light = torch.full_like(blocks, _DIM, dtype=torch.float64)
        light[slice(*brightest[:2]), slice(*brightest[2:])] = 1
        chosen = blocks[slice(*sides[:2]), slice(*sides[2:])].flatten()
        places = self._places[chosen]
        length = _LENGTH * max(brightest[1] - brightest[0], brightest[3] - brightest[2])
        alike = 1 + _CONTRAST**2 * torch.exp(-torch.cdist(places, places) / length)
        root = light.flatten()[chosen, None] * torch.linalg.cholesky(alike)
        total = 0.0
        for gram, sums in zip(self._grams, self._sums, strict=True):
            values, vectors = torch.linalg.eigh(root.T @ gram[chosen][:, chosen] @ root)
            values = values.clamp_min(0)
            powers = (vectors.T @ (root.T @ sums[chosen])).square()
            strengths = (_STRENGTHS.to(values) / values[-1].clamp_min(_DARK))[:, None]
            spread = 1 + strengths * values
            each = (strengths * powers / spread - spread.log()).sum(1) / 2
            total += float(each.max())
        return total


def _without(basis: Tensor, light: Tensor) -> Tensor:
    """Light, (…, means), without its part in a basis, (means, number)."""
    part: Tensor = (light @ basis) @ basis.T
    return light - part


def _excess(gram: Tensor, sums: Tensor, power: float, pixels: int) -> float:
    """What the blocks leave of a channel: see `Evidence.excess`."""
    values, vectors = torch.linalg.eigh(gram)
    resolved = values > _RESOLVED
    explained = ((vectors.T @ sums)[resolved].square() / values[resolved]).sum()
    return max(1.0, (power - float(explained)) / max(1, pixels - int(resolved.sum())))


def _means(planes: Tensor, by: int) -> Tensor:
    means: Tensor = nnf.avg_pool2d(planes, by)
    return means
