"""A trained ridge regulariser: filters of a picture, and what their answers cost."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
import torch
import torch.nn.functional as nnf
from numpy.typing import NDArray
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.kernels import odd_spline_
from nolens.solvers.functionals import Functional, length

MODULUS = 0.9
"""−∂²ψ at most: ½‖v − y‖² + R(v) is convex, with what the borders add to the filters' norm."""
STEEPEST = 12.0
"""∂²ψ at most."""
_LEVELS = 0.003, 1.0
"""Least and most noise, of a white of 1, that the potentials depend on."""
_LEVEL = 0.1
"""Noise to which the stored potentials belong."""
_GRID = 128
"""Frequencies along an axis at which the filters' norm is computed."""
_POWER_STEPS, _SAFETY = 100, 1.01
"""Of the norm with borders, which power iteration gives from below."""
_STRENGTH, _SIGMA = 0.3, 0.06
"""Of a photograph's prior."""
_INNER, _INNER_TOLERANCE = 5, 1e-4
"""Of the proximal map in each iteration for a photograph, from the result before."""
_ROWS = 64
"""Rows at a time: what all filters say of more does not stay in the cache."""

Array = NDArray[Any]


@dataclass(frozen=True)
class RidgeWeights:
    r"""What a ridge regulariser has learned: filters and their potentials.

    Filter i is :math:`w_i = \sum_m f_{im} * b_m`, of a few wide filters b of the picture's colours
    and many narrow filters f of what those give, as `goujon2024` composes them. The colours are
    the picture's mean, red against blue, and green against both, an orthonormal basis. Each f has
    the mean 0.

    Parameters
    ----------
    bases
        b, (bases, 3, side, side) of an odd side.
    filters
        f, (filters, bases, side, side) of an odd side.
    knots
        Logarithms of where the slope of ψ bends, over σ, each next to the one before: the first,
        and increments, (filters, knots).
    bends
        ∂²ψ between the knots, as logits between −`MODULUS` and `STEEPEST`, (filters, knots).
    trends
        Change of the logarithm of all knots, and of all logits, when the noise is ten times as
        strong, (filters, 2).

    Raises
    ------
    DataError
        If shapes or values cannot be used.
    """

    bases: Tensor
    filters: Tensor
    knots: Tensor
    bends: Tensor
    trends: Tensor

    def __post_init__(self) -> None:
        count, wide = len(self.filters), len(self.bases)
        shapes = [tuple(getattr(self, each.name).shape) for each in fields(self)]
        sides = [*self.bases.shape[2:], *self.filters.shape[2:]]
        number = self.knots.shape[-1]
        expected = [
            (wide, 3, *sides[:1] * 2),
            (count, wide, *sides[-1:] * 2),
            (count, number),
            (count, number),
            (count, 2),
        ]
        if shapes != expected or not all(side % 2 for side in sides):
            raise DataError(f"weights of a ridge regulariser have the shapes {shapes}")
        if not all(bool(torch.isfinite(getattr(self, each.name)).all()) for each in fields(self)):
            raise DataError("weights of a ridge regulariser hold NaN or infinity")

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, Array]) -> Self:
        """From arrays by name, of any floating type.

        Filters get the mean 0, which rounding took.

        Raises
        ------
        DataError
            If one is missing, or cannot be used.
        """
        missing = [each.name for each in fields(cls) if each.name not in arrays]
        if missing:
            raise DataError(f"weights of a ridge regulariser lack {', '.join(missing)}")
        weights = cls(
            **{
                each.name: torch.from_numpy(np.array(arrays[each.name], np.float32))
                for each in fields(cls)
            }
        )
        return replace(
            weights, filters=weights.filters - weights.filters.mean(dim=(2, 3), keepdim=True)
        )

    def arrays(self) -> dict[str, Array]:
        """Arrays by name, as `from_arrays` takes them; float32."""
        return {
            each.name: getattr(self, each.name).detach().cpu().float().numpy()
            for each in fields(self)
        }

    @property
    def count(self) -> int:
        """Number of parameters."""
        return sum(getattr(self, each.name).numel() for each in fields(self))

    @property
    def reach(self) -> int:
        """Pixels from a filter's middle to its border."""
        return (self.bases.shape[-1] + self.filters.shape[-1] - 2) // 2

    @cached_property
    def norm(self) -> float:
        """‖W‖ with borders, by power iteration, and without them by its bound: the larger."""
        bank = FilterBank(self.bases.double(), self.filters.double())
        side = 3 * bank.reach
        generator = torch.Generator().manual_seed(0)
        picture = torch.randn(1, 3, side, side, generator=generator, dtype=torch.float64)
        size = 1.0
        for _ in range(_POWER_STEPS):
            picture = bank.adjoint(bank(picture / size))
            size = length(picture)
        return max(_SAFETY * math.sqrt(size), filter_norm(self.bases, self.filters))

    def potentials(self, level: Tensor) -> "Potentials":
        """Of arguments over σ, for noise of σ = level · white.

        Parameters
        ----------
        level
            (count,) of pictures.
        """
        decades = torch.log10(level.clamp(*_LEVELS) / _LEVEL)[:, None, None]
        knots = self.knots.exp().cumsum(-1) * torch.exp(decades * self.trends[:, :1])
        logits = self.bends + decades * self.trends[:, 1:]
        bends = (STEEPEST + MODULUS) * torch.sigmoid(logits) - MODULUS
        after = torch.cat([bends[..., 1:], torch.zeros_like(bends[..., :1])], dim=-1)
        tau, mass = (each.permute(2, 0, 1)[..., None, None] for each in (knots, bends - after))
        return Potentials(tau, mass, float(bends.detach().max()), -float(bends.detach().min()))


class Potentials(NamedTuple):
    r"""ψ of each filter, a sum of Huber's functions, some of which are taken off.

    .. math:: ψ(t) = \sum_k m_k h_{τ_k}(t), \qquad ψ'(t) = \sum_k m_k \min(\max(t, −τ_k), τ_k),

    with h of `huber1964`. ψ′ is an odd linear spline, level beyond the last knot; its slope between
    two knots is the sum of all m from the upper one on.

    Parameters
    ----------
    knots, masses
        τ and m, (knots, pictures, filters, 1, 1).
    steepest, concavity
        Largest ψ″, and largest −ψ″.
    """

    knots: Tensor
    masses: Tensor
    steepest: float
    concavity: float

    def value(self, t: Tensor) -> Tensor:
        """ψ."""
        total = torch.zeros_like(t)
        for knot, mass in zip(self.knots, self.masses, strict=True):
            near = torch.clamp(t, -knot, knot)
            total = total + mass * near * (t - 0.5 * near)
        return total

    def slope_(self, t: Tensor) -> Tensor:
        """ψ′; t may be overwritten."""
        return odd_spline_(t, self.knots, self.masses)

    def bend(self, t: Tensor) -> Tensor:
        """ψ″."""
        total, size = torch.zeros_like(t), t.abs()
        for knot, mass in zip(self.knots, self.masses, strict=True):
            total = total + mass * (size < knot)
        return total


class FilterBank:
    r"""W: pictures (count, planes, height, width) to (count, filters, height, width), and W*.

    Beyond the border the picture is its mirror image.

    Parameters
    ----------
    bases, filters
        As `RidgeWeights` has them; those of one plane are of the mean alone.
    """

    def __init__(self, bases: Tensor, filters: Tensor) -> None:
        self._forward = tuple(_last(each) for each in (bases, filters))
        self._back = tuple(_last(each.flip(2, 3).transpose(0, 1)) for each in (filters, bases))
        self._sides = bases.shape[-1], filters.shape[-1]
        self.reach = sum(side // 2 for side in self._sides)

    def pad(self, pictures: Tensor) -> Tensor:
        """With what lies beyond the border."""
        for axis in (-2, -1):
            size = pictures.shape[axis]
            before = pictures.narrow(axis, 0, self.reach).flip(axis)
            after = pictures.narrow(axis, size - self.reach, self.reach).flip(axis)
            pictures = torch.cat([before, pictures, after], dim=axis)
        return _last(pictures)

    def pad_adjoint(self, padded: Tensor) -> Tensor:
        """What lies beyond the border, added to the pixels that it mirrors."""
        for axis in (-2, -1):
            padded = _fold(padded, self.reach, axis)
        return padded

    def within(self, padded: Tensor) -> Tensor:
        """W of padded pictures, where the filters lie within them."""
        for kernel in self._forward:
            padded = _convolved(padded, kernel)
        return padded

    def within_adjoint(self, answers: Tensor) -> Tensor:
        """The adjoint of `within`."""
        for kernel, side in zip(self._back, reversed(self._sides), strict=True):
            answers = _convolved(answers, kernel, side - 1)
        return answers

    def __call__(self, pictures: Tensor) -> Tensor:
        """W."""
        return self.within(self.pad(pictures))

    def adjoint(self, answers: Tensor) -> Tensor:
        """W*."""
        return self.pad_adjoint(self.within_adjoint(answers))


def _convolved(planes: Tensor, kernel: Tensor, padding: int = 0) -> Tensor:
    """Convolution of float32, which cuDNN would round to ten bits: the objective would not fall."""
    if not planes.is_cuda:
        return nnf.conv2d(planes, kernel, padding=padding)
    with torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
        return nnf.conv2d(planes, kernel, padding=padding)


def filter_norm(bases: Tensor, filters: Tensor, grid: int = _GRID) -> float:
    r"""A bound of ‖W‖ on a plane without borders.

    .. math:: ‖W‖^2 = \max_ω λ_{\max}\Big(\sum_i \hat w_i(ω)^* \hat w_i(ω)\Big)

    Each quadratic form of the matrix is a trigonometric polynomial p ≥ 0 of a degree n along each
    axis. Around its maximum such a p is no lower than max p · cos nω, so that one of N samples is
    at least max p · cos(πn/N).

    Parameters
    ----------
    bases, filters
        As `RidgeWeights` has them.
    grid
        N.
    """
    degree = bases.shape[-1] + filters.shape[-1] - 2
    largest = largest_gain(bases.double(), filters.double(), grid)
    return float(largest.sqrt()) / math.cos(math.pi * degree / grid)


def largest_gain(bases: Tensor, filters: Tensor, grid: int) -> Tensor:
    """‖W‖² at the frequencies of a grid; with a gradient."""
    wide, narrow = (torch.fft.rfft2(each, s=(grid, grid)) for each in (bases, filters))
    wide, narrow = (each.permute(2, 3, 0, 1).flatten(0, 1) for each in (wide, narrow))
    gains = narrow @ wide
    largest: Tensor = torch.linalg.eigvalsh(gains.mH @ gains).max()
    return largest


class RidgeRegulariser(Functional):
    r"""A sum of potentials of filtered pictures, all of it trained (`goujon2023`, `goujon2024`).

    .. math:: R_σ(v) = σ^2 \sum_i \sum_p ψ_i\big((w_i * v)_p / σ\big)

    With the noise's standard deviation σ, its proximal map of step 1 takes white noise out of a
    picture. −ψ″ is at most `MODULUS` and ‖W‖ about 1, so that ½‖v − y‖² + R(v) is convex though R
    is not. R depends on the unit of brightness as ‖v‖² does,
    :math:`R_{cσ}(cv) = c^2 R_σ(v)`, with the white in the same unit. A uniform picture costs
    nothing.

    Pictures of three channels are taken as red, green and blue; the channels of any others one by
    one.

    Parameters
    ----------
    weights
        What was learned.
    sigma
        σ > 0, in the picture's unit.
    white
        Value of a white pixel, > 0.
    non_negative
        Whether R is infinite where a pixel is below 0. Its proximal map knows that; it has no
        gradient then.
    iterations, tolerance
        Limit of the proximal map, which ends when a step moves x by no more than tolerance · ‖x‖.

    Raises
    ------
    OptionError
        If σ or the white is not above 0.
    """

    def __init__(
        self,
        weights: RidgeWeights,
        sigma: float,
        *,
        white: float = 1.0,
        non_negative: bool = False,
        iterations: int = 1000,
        tolerance: float = 1e-6,
    ) -> None:
        if not (0 < sigma < math.inf and 0 < white < math.inf):
            raise OptionError(f"sigma is {sigma} and white {white}; they must be above 0")
        self.weights, self.sigma, self.non_negative = weights, float(sigma), non_negative
        self._level = self.sigma / white
        self._banks: dict[tuple[int, torch.dtype, torch.device], tuple[FilterBank, Potentials]] = {}
        potentials = self._bank(torch.zeros(1))[1]
        self._bound = max(potentials.steepest, potentials.concavity) * weights.norm**2
        self.lipschitz = None if non_negative else self._bound
        self.concavity = max(potentials.concavity, 0.0) * weights.norm**2
        self._iterations, self._tolerance = iterations, tolerance
        self._before: Tensor | None = None

    def _value(self, v: Tensor) -> Tensor:
        if self.non_negative and bool((v < 0).any()):
            return v.new_tensor(math.inf, dtype=torch.float64)
        bank, potentials = self._bank(v)
        total = v.new_zeros((), dtype=torch.float64)
        for padded, _ in _parts(bank, self._planes(v)):
            total += potentials.value(bank.within(padded)).sum(dtype=torch.float64)
        return total * self.sigma**2

    def gradient(self, v: Tensor) -> Tensor:
        r"""σ W*ψ′(Wv/σ)."""
        if self.non_negative:
            return super().gradient(v)
        return self._slope(v)

    def _slope(self, v: Tensor) -> Tensor:
        bank, potentials = self._bank(v)
        planes = self._planes(v)
        slope = torch.zeros_like(bank.pad(planes))
        for padded, part in _parts(bank, planes, slope):
            part += bank.within_adjoint(potentials.slope_(bank.within(padded)))
        return bank.pad_adjoint(slope).reshape(v.shape) * self.sigma

    def prox(self, v: Tensor, step: float) -> Tensor:
        """By accelerated gradient with restart (`odonoghue2015`), from the result before.

        It is the one minimiser where step · `concavity` < 1, and else a minimum.
        """
        start = self._before if self._before is not None and self._before.shape == v.shape else v
        x = ahead = start.to(v).clamp_min(0) if self.non_negative else start.to(v)
        rate = 1 / (1 + step * self._bound)
        momentum = 1.0
        for _ in range(self._iterations):
            before = x
            x = ahead - rate * (ahead - v + step * self._slope(ahead))
            if self.non_negative:
                x = x.clamp_min(0)
            moved = x - before
            if length(moved) <= self._tolerance * length(x):
                break
            if float(((ahead - x) * moved).sum()) > 0:
                momentum = 1.0
            following = (1 + math.sqrt(1 + 4 * momentum**2)) / 2
            factor, momentum = (momentum - 1) / following, following
            ahead = x + factor * moved
        self._before = x
        return x

    def _bank(self, v: Tensor) -> tuple[FilterBank, Potentials]:
        """Filters and potentials of the picture's type, for its number of channels."""
        colours = _colours(v)
        key = colours, v.dtype, v.device
        if key not in self._banks:
            weights = RidgeWeights(
                **{
                    each.name: getattr(self.weights, each.name).to(v)
                    for each in fields(RidgeWeights)
                }
            )
            bases = weights.bases[:, :1]
            if colours == 3:
                bases = torch.einsum("bpij,pc->bcij", weights.bases, opponents().to(v))
            level = torch.tensor([self._level]).to(v)
            self._banks[key] = FilterBank(bases, weights.filters), weights.potentials(level)
        return self._banks[key]

    def _planes(self, v: Tensor) -> Tensor:
        """In units of σ, (count, planes, height, width)."""
        least = self.weights.reach
        if v.ndim < 2 or min(v.shape[-2:]) < least:
            raise DataError(
                f"the picture is {tuple(v.shape)}; the ridge regulariser needs at least {least} "
                f"pixels along each side"
            )
        return v.reshape(-1, _colours(v), *v.shape[-2:]) / self.sigma


@dataclass(frozen=True)
class RidgePrior:
    r"""What a photograph is assumed to be like: −ln p(v) = s R_σ(v)/σ² over v ≥ 0, white 1.

    It is one p for every camera, exposure and picture: the weight of the data is the noise's. With
    s = 1 it would be the p whose most probable picture is best where white noise of σ is all that
    is wrong with it; a measurement without a lens leaves noise that is not white. It is a
    `nolens.solvers.scene_prior.ScenePrior`.

    Parameters
    ----------
    weights
        What was learned.
    strength, sigma
        s and σ. Those that are set suit simulated photographs of several masks and exposures.
    facts
        What a record says of it: the prior, and the hash of its weights.
    detail
        What s is divided by: 2 shows more detail and more noise.
    """

    weights: RidgeWeights = field(repr=False)
    strength: float = _STRENGTH
    sigma: float = _SIGMA
    facts: dict[str, str] = field(default_factory=dict)
    detail: float = 1.0

    def __call__(self, first: Tensor) -> Functional:
        """The functional, whatever the first photograph."""
        ridge = RidgeRegulariser(
            self.weights,
            self.sigma,
            non_negative=True,
            iterations=_INNER,
            tolerance=_INNER_TOLERANCE,
        )
        return (self.strength / self.detail / self.sigma**2) * ridge


def opponents() -> Tensor:
    """Mean, red against blue, green against both: an orthonormal basis of colours, in rows."""
    rows = torch.tensor([[1.0, 1, 1], [1, 0, -1], [-1, 2, -1]], dtype=torch.float64)
    basis: Tensor = rows / torch.linalg.vector_norm(rows, dim=1, keepdim=True)
    return basis


def _parts(bank: FilterBank, planes: Tensor, *like: Tensor) -> Iterator[tuple[Tensor, Tensor]]:
    """Some rows at a time: of padded pictures, and of a tensor like them."""
    padded = bank.pad(planes)
    beside = like[0] if like else padded
    for first in range(0, planes.shape[-2], _ROWS):
        rows = min(_ROWS, planes.shape[-2] - first) + 2 * bank.reach
        yield padded.narrow(-2, first, rows), beside.narrow(-2, first, rows)


def _colours(v: Tensor) -> int:
    """Channels that are taken together."""
    return 3 if v.ndim > 2 and v.shape[-3] == 3 else 1


def _last(tensor: Tensor) -> Tensor:
    return tensor.contiguous(memory_format=torch.channels_last)


def _fold(padded: Tensor, reach: int, axis: int) -> Tensor:
    """The adjoint of a mirror image along an axis."""
    size = padded.shape[axis] - 2 * reach
    before, inner, after = torch.split(padded, [reach, size, reach], axis)
    pairs = ((before, 0), (after, size - reach))
    folded = inner.clone()
    for part, first in pairs:
        folded.narrow(axis, first, reach).add_(part.flip(axis))
    return folded
