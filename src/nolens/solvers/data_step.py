"""ADMM that fits the measurement in its linear step, by preconditioned conjugate gradients."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import PassSums, SplitState, irfft2, irfft2_window_, rfft2_window
from nolens.operators import FiniteDifference
from nolens.solvers.admm_state import AdmmState, Penalties
from nolens.solvers.functionals import OpponentL1
from nolens.solvers.problem import Prior, Problem

DATA_STEP_RELAXATION = 1.5
"""α where no other is given."""
_START_SCENE = 0.02
_START_VARIATION = 5.0
"""Penalties to start with: that of the scene, and that of its variation over τ and the scene's
level. Small ones let the scene follow the data at once, of whatever sign it becomes."""
_START_DARK, _FOLLOWING_DARK = 0.05, 0.3
"""Those of a scene that does not fill the view, of a cold start and of a frame that follows: with a
small one, what the sensor hardly sees of it goes astray for tens of frames."""
_INNER = 3
"""Steps of conjugate gradients in each iteration."""
_MODES = 3
"""Slow cosines along each side that are solved for exactly."""
_TINY = 1e-300
_PIXELS = 20_000
"""That are in float64 at a time."""


def data_step_start(problem: Problem, state: AdmmState, *, follows: bool = False) -> Penalties:
    """Penalties of a cold start, or where the scene follows from another frame's.

    Its level is its mean where it fills the view; in the dark it is the root mean square of
    a scene that A passes on as it is, 1/√N for N pixels.
    """
    if state.fills_view:
        level, scene = float(state.scene().mean()), _START_SCENE
    else:
        level = 1 / math.sqrt(math.prod(problem.scene_shape[1:]))
        scene = _FOLLOWING_DARK if follows else _START_DARK
    level = max(level, torch.finfo(torch.float32).tiny)
    return _START_SCENE, _START_VARIATION * problem.tau / level if problem.varied else 1.0, scene


class DataStep:
    r"""Iterates with two splits, u = Ψv and w = v; the measurement stays with v.

    In the Douglas-Rachford form of `nolens.kernels.admm`, each iteration solves, for each channel,

    .. math:: (A^*A + μ_2 Ψ^*Ψ + μ_3)\, v = A^*b + μ_2 Ψ^* q_u + μ_3 q_w, \qquad A = VCM,

    with V the valid pixels. So the measurement does not have to travel through a split x = Mv of
    its own, which is slow where a scene fills the view: light beyond the sensor is not measured,
    and the slow part of a scene hardly changes what is. The matrix is not diagonal in the Fourier
    domain. A few steps of conjugate gradients go on from the scene before (inexact ADMM,
    `eckstein2017`), preconditioned by its circulant mean
    :math:`ρ\,|H|^2 / \overline{|H|^2} + μ_2|D|^2 + μ_3`, where ρ is the fraction of the energy of
    white noise that A keeps, and an exact solution for the slowest cosines, deflated (A-DEF2 of
    `tang2009`): the eigenvalue of the scene's mean is ten thousand times that of the others.

    The forward model may vary over the field; :math:`|H|^2` is then the mean of its terms'.

    Parameters
    ----------
    problem
        In normalised units.
    splits
        Of every channel, where to start from; `write` brings them up to date, the split x where
        the sensor is.
    penalties
        Of the splits.
    relaxation
        α in (0, 2).
    """

    def __init__(
        self,
        problem: Problem,
        splits: list[SplitState],
        penalties: Penalties,
        relaxation: float,
    ) -> None:
        self._penalties, self._relaxation = penalties, relaxation
        self._norm = problem.norm_of_differences if problem.varied else None
        self._tau = problem.tau
        self._l1 = problem.tau if problem.prior is Prior.L1 else 0.0
        self._channels = [
            _Channel(problem.single(number), split) for number, split in enumerate(splits)
        ]
        for channel in self._channels:
            channel.v = self._w(channel.a_w)

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement of the same sizes, or another weight; both above zero."""
        self._tau = problem.tau
        self._l1 = problem.tau if problem.prior is Prior.L1 else 0.0
        for number, channel in enumerate(self._channels):
            channel.measure(problem.single(number))

    def iterate(self, count: int, penalties: Penalties) -> list[PassSums]:
        """Make so many iterations with these penalties; the sums of every channel's last."""
        self._go_on_with(penalties)
        for channel in self._channels:
            channel.renew_residual()
        for _ in range(count - 1):
            self._step()
        before = [(each.a_u.clone(), each.a_w.clone()) for each in self._channels]
        self._step()
        variation = self._variation()
        after = self._u(self._multiplied)
        earlier = self._u([a_u for a_u, _ in before])
        return [
            each.sums((u, self._w(each.a_w)), (a_u, u_before), (a_w, self._w(a_w)), variation)
            for each, u, u_before, (a_u, a_w) in zip(
                self._channels, after, earlier, before, strict=True
            )
        ]

    def write(self, splits: list[SplitState]) -> None:
        """Write the splits u and w with their multipliers, and x on the valid pixels."""
        for channel, split in zip(self._channels, splits, strict=True):
            channel.write(split)

    def _u(self, multiplied: list[Tensor]) -> Iterator[Tensor]:
        """Proximal map of the variation, of one channel after the other."""
        step = self._tau / self._penalties[1] if self._norm is not None else 0.0
        if isinstance(self._norm, OpponentL1):
            yield from torch.split(self._norm.prox(torch.cat(multiplied), step), 1)
            return
        for each in multiplied:
            yield each if self._norm is None else self._norm.prox(each, step)

    def _w(self, multiplied: Tensor) -> Tensor:
        """Proximal map of non-negativity, and of the ℓ1 norm."""
        return (multiplied - self._l1 / self._penalties[2]).clamp_min_(0)

    def _variation(self) -> float:
        """R(v) of the differences, mean over channels."""
        if self._norm is None:
            return 0.0
        varied = (each.varied(each.v) for each in self._channels)
        if isinstance(self._norm, OpponentL1):
            total = float(self._norm(torch.cat(list(varied))))
        else:
            total = sum(float(self._norm(each)) for each in varied)
        return total / len(self._channels)

    def _go_on_with(self, penalties: Penalties) -> None:
        """Keep splits and multipliers μd with other penalties."""
        if penalties == self._penalties:
            return
        _, second, third = (
            before / after if after > 0 else 1.0
            for before, after in zip(self._penalties, penalties, strict=True)
        )
        for each, u in zip(self._channels, self._u(self._multiplied), strict=True):
            each.a_u = torch.lerp(u, each.a_u, second)
            each.a_w = torch.lerp(self._w(each.a_w), each.a_w, third)
        self._penalties = penalties

    def _step(self) -> None:
        for each, u in zip(self._channels, self._u(self._multiplied), strict=True):
            each.step(u, self._w(each.a_w), self._penalties, self._relaxation)

    @property
    def _multiplied(self) -> list[Tensor]:
        """Of every channel, u with its multipliers."""
        return [each.a_u for each in self._channels]


class _Channel:
    """One channel: its scene, and its splits with their multipliers."""

    def __init__(self, problem: Problem, split: SplitState) -> None:
        self._problem = problem
        self._frame = _Frame.of(problem)
        self._difference = FiniteDifference(self._frame.size)
        self._tv = problem.varied
        self.a_w = self._frame.scene_of(split.scene)[None].clone()
        self.a_u = self._frame.differences_of(split, varied=self._tv)
        self.v = self.a_w
        self._residual = problem.data
        self._circulant = _Circulant(problem)
        self._cosines = _Cosines(problem)

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement."""
        if not torch.equal(problem.valid, self._problem.valid):
            self._cosines.measure(problem)
        self._problem = problem

    def renew_residual(self) -> None:
        """Compute the residual anew, of which steps lose a little each."""
        self._residual = self._problem.residual(self.v)

    def write(self, split: SplitState) -> None:
        """Write the splits u and w with their multipliers, and x on the valid pixels."""
        top, left, height, width = split.sensor
        light = self._problem.data[0] - self._residual[0]
        split.measured[top : top + height, left : left + width] = light
        split.scene.zero_()
        self._frame.scene_of(split.scene).copy_(self.a_w[0])
        if self._tv:
            self._frame.write_differences_(split, self.a_u)

    def step(self, u: Tensor, w: Tensor, penalties: Penalties, relaxation: float) -> None:
        """One iteration, from the proximal maps at `a_u` and `a_w`."""
        _, second, third = penalties
        target = (2 * w - self.a_w).mul_(third)
        if self._tv:
            target += self._varied_back(2 * u - self.a_u).mul_(second)
        self._solve(target, penalties)
        self.a_w += (self.v - w).mul_(relaxation)
        if self._tv:
            self.a_u += (self.varied(self.v) - u).mul_(relaxation)

    def varied(self, scene: Tensor) -> Tensor:
        """Ψv of a scene, (1, 2, height, width)."""
        return self._difference(self._frame.framed(scene))

    def sums(
        self,
        splits: tuple[Tensor, Tensor],
        u_before: tuple[Tensor, Tensor],
        w_before: tuple[Tensor, Tensor],
        variation: float,
    ) -> PassSums:
        """Sums of an iteration: splits after it; each before it, with its multipliers and alone."""
        varied = self.varied(self.v) if self._tv else self.a_u
        (u, w), (a_u, u_then), (a_w, w_then) = splits, u_before, w_before
        return PassSums(
            primal=(0.0, _squares(varied - u), _squares(self.v - w)),
            split=(0.0, _squares(u), _squares(w)),
            change=(0.0, _squares(u - u_then), _squares(w - w_then)),
            multiplier_change=(
                0.0,
                _squares((self.a_u - u) - (a_u - u_then)),
                _squares((self.a_w - w) - (a_w - w_then)),
            ),
            residual=_squares(self._problem.residual(self.v)),
            variation=variation,
            magnitude=float(self.v.abs().sum(dtype=torch.float64)),
        )

    def _solve(self, target: Tensor, penalties: Penalties) -> None:
        """Go nearer to the scene with Kv = A*b + target."""
        cosines, forward = self._cosines, self._problem.forward
        circulant = self._circulant.inverse(penalties)
        matrix = cosines.matrix(penalties)
        amounts = matrix.solve(
            cosines.along_image(self._residual)
            + cosines.along(target - self._prior_part(penalties, self.v))
        )
        self.v = self.v + cosines.sum(amounts)
        self._residual -= cosines.image(amounts)
        direction = image = before = product = None
        for _ in range(_INNER):
            left = forward.adjoint(self._residual) + target - self._prior_part(penalties, self.v)
            ahead = circulant(left)
            light = self._image(ahead)
            missed = cosines.along(left - self._prior_part(penalties, ahead)) - cosines.along_image(
                light
            )
            amounts = matrix.solve(missed)
            ahead += cosines.sum(amounts)
            light += cosines.image(amounts)
            slope = _dot(left, ahead)
            if direction is None or image is None or before is None or product is None:
                direction, image = ahead, light
            else:
                # Polak-Ribière: the preconditioner need not be exact.
                turn = float(
                    ((slope - _dot(before, ahead)) / product.clamp_min(_TINY)).clamp_min(0)
                )
                direction, image = ahead.add_(direction, alpha=turn), light.add_(image, alpha=turn)
            before, product = left, slope
            bend = _dot(image, image) + _dot(direction, self._prior_part(penalties, direction))
            length = float(_dot(left, direction) / bend.clamp_min(_TINY))
            self.v.add_(direction, alpha=length)
            self._residual.sub_(image, alpha=length)

    def _image(self, scene: Tensor) -> Tensor:
        """A v: what the valid pixels see of a scene."""
        return self._problem.forward(scene).mul_(self._problem.valid)

    def _prior_part(self, penalties: Penalties, scene: Tensor) -> Tensor:
        """(μ₂Ψ*Ψ + μ₃) v: four times each pixel, less its neighbours; zero around the scene."""
        _, second, third = penalties
        if not self._tv:
            return third * scene
        part = (4 * second + third) * scene
        for axis, around in zip((-2, -1), self._frame.first, strict=True):
            length = scene.shape[axis]
            inner = (axis, 0, length - 1), (axis, 1, length - 1)
            for one, other in (inner, inner[::-1]):
                part.narrow(*one).sub_(scene.narrow(*other), alpha=second)
            if around == 0:  # The scene is the whole padded shape, and goes around.
                part.narrow(axis, 0, 1).sub_(scene.narrow(axis, length - 1, 1), alpha=second)
                part.narrow(axis, length - 1, 1).sub_(scene.narrow(axis, 0, 1), alpha=second)
        return part

    def _varied_back(self, differences: Tensor) -> Tensor:
        return self._frame.unframed(self._difference.adjoint(differences))


@dataclass(frozen=True)
class _Frame:
    """The scene's pixels with the zero beside them, which differences need, and their place.

    `first` is where the scene begins in the frame; the frame goes around, as the padded shape does.
    """

    scene: tuple[int, int, int, int]
    size: tuple[int, int]
    first: tuple[int, int]
    rows: Tensor
    columns: Tensor

    @classmethod
    def of(cls, problem: Problem) -> "_Frame":
        scene, padded = problem.forward.geometry.scene, problem.forward.geometry.padded
        size = min(scene[2] + 1, padded[0]), min(scene[3] + 1, padded[1])
        first = size[0] - scene[2], size[1] - scene[3]
        rows, columns = (
            (torch.arange(size[axis]) + scene[axis] - first[axis]) % padded[axis] for axis in (0, 1)
        )
        device = problem.data.device
        return cls(scene, size, first, rows.to(device)[:, None], columns.to(device))

    def scene_of(self, array: Tensor) -> Tensor:
        """The scene's pixels of an array of the padded shape."""
        top, left, height, width = self.scene
        return array[..., top : top + height, left : left + width]

    def differences_of(self, split: SplitState, *, varied: bool) -> Tensor:
        """The split u, (1, 2, height, width) of the frame; nothing where there is none."""
        if not varied:
            return split.rows.new_empty(1, 2, 0, 0)
        parts = [each[self.rows, self.columns] for each in (split.rows, split.columns)]
        return torch.stack(parts)[None]

    def write_differences_(self, split: SplitState, values: Tensor) -> None:
        """The inverse of `differences_of`; zero beside the frame."""
        for array, each in zip((split.rows, split.columns), values[0], strict=True):
            array.zero_()
            array[self.rows, self.columns] = each

    def framed(self, scene: Tensor) -> Tensor:
        """A scene on the frame."""
        framed = scene.new_zeros((*scene.shape[:-2], *self.size))
        self.unframed(framed).copy_(scene)
        return framed

    def unframed(self, framed: Tensor) -> Tensor:
        """The scene's pixels of a frame; the adjoint of `framed`."""
        (top, left), (_, _, height, width) = self.first, self.scene
        return framed[..., top : top + height, left : left + width]


class _Circulant:
    """The circulant mean of the matrix, and its inverse on the scene's pixels."""

    def __init__(self, problem: Problem) -> None:
        self._geometry = problem.forward.geometry
        height, width = self._geometry.padded
        rows, columns = (
            2 - 2 * torch.cos(2 * math.pi * torch.arange(count) / side)
            for count, side in ((height, height), (width // 2 + 1, width))
        )
        self._rows, self._columns = rows.to(problem.data)[:, None], columns.to(problem.data)
        power = problem.forward.power
        energy = irfft2(power.to(torch.complex64), self._geometry.padded)[0, 0, 0]
        self._data = power.mul_(_fraction_on_sensor(problem) / energy)
        self._penalties: Penalties | None = None
        self._inverse = self._data

    def inverse(self, penalties: Penalties) -> "_Circulant":
        """With these penalties."""
        if penalties != self._penalties:
            _, second, third = self._penalties = penalties
            steps = self._rows + self._columns
            self._inverse = (second * steps + self._data).add_(third).reciprocal_()
        return self

    def __call__(self, scene: Tensor) -> Tensor:
        geometry = self._geometry
        spectrum = rfft2_window(scene, geometry.scene[:2], geometry.padded)
        return irfft2_window_(spectrum.mul_(self._inverse), geometry.scene, geometry.padded)


def _fraction_on_sensor(problem: Problem) -> Tensor:
    """ρ = E‖An‖² / E‖n‖² for white noise n without a mean."""
    generator = torch.Generator().manual_seed(0)
    signs = torch.randint(0, 2, problem.scene_shape, generator=generator) * 2.0 - 1
    noise = (signs - signs.mean()).to(problem.data)
    image = problem.forward(noise) * problem.valid
    return (_dot(image, image) / _dot(noise, noise)).to(noise)


class _Cosines:
    """Slow cosines of the scene, products of `_MODES` along each side, and what A makes of them."""

    def __init__(self, problem: Problem) -> None:
        height, width = problem.scene_shape[1:]
        self._rows, self._columns = (
            slow_cosines(each).to(problem.data) for each in (height, width)
        )
        modes = (row[:, None] * column for row in self._rows for column in self._columns)
        self._images = torch.cat([problem.forward(each[None]) for each in modes])
        self.measure(problem)
        self._gram_varied = torch.zeros_like(self._gram)
        if problem.varied:
            around = _Frame.of(problem).first
            rows, columns = (
                (gram(each), gram(steps_along(each, beyond)))
                for each, beyond in zip((self._rows, self._columns), around, strict=True)
            )
            self._gram_varied = torch.kron(rows[1], columns[0]) + torch.kron(rows[0], columns[1])

    def measure(self, problem: Problem) -> None:
        """See them by the valid pixels of a measurement."""
        self._valid = problem.valid
        self._gram = gram(self._images.flatten(1), self._valid.flatten())

    def matrix(self, penalties: Penalties) -> "_Coarse":
        """The matrix in the space of the cosines."""
        _, second, third = penalties
        unit = torch.eye(len(self._gram)).to(self._gram)
        return _Coarse(
            torch.linalg.cholesky(self._gram + second * self._gram_varied + third * unit)
        )

    def along(self, scene: Tensor) -> Tensor:
        """Inner products with the cosines."""
        return (self._rows @ scene @ self._columns.T).flatten()

    def along_image(self, image: Tensor) -> Tensor:
        """Inner products of an image on the valid pixels with what A makes of the cosines."""
        return self._images.flatten(1) @ image.flatten()

    def sum(self, amounts: Tensor) -> Tensor:
        """The scene of so much of each."""
        return self._rows.T @ amounts.view(len(self._rows), -1) @ self._columns

    def image(self, amounts: Tensor) -> Tensor:
        """What the sensor sees of that."""
        image: Tensor = (amounts @ self._images.flatten(1)).view_as(self._valid)
        return image.mul_(self._valid)


@dataclass(frozen=True)
class _Coarse:
    """The Cholesky factor of a small matrix."""

    factor: Tensor

    def solve(self, amounts: Tensor) -> Tensor:
        """Amounts of the cosines whose products with the matrix these are."""
        solution: Tensor = torch.cholesky_solve(amounts.double()[:, None], self.factor)
        return solution[:, 0].to(amounts)


def slow_cosines(count: int) -> Tensor:
    """Cosines of 0, 1, … half waves along `count` pixels, of unit norm."""
    place = (torch.arange(count, dtype=torch.float64) + 0.5) / count
    modes = torch.arange(min(_MODES, count), dtype=torch.float64)
    waves = torch.cos(math.pi * modes[:, None] * place)
    unit: Tensor = waves / torch.linalg.vector_norm(waves, dim=1, keepdim=True)
    return unit


def steps_along(waves: Tensor, beyond: int) -> Tensor:
    """Differences along waves, to so many zeros beyond them, and around."""
    padded = nnf.pad(waves, (0, beyond))
    return padded - padded.roll(1, -1)


def gram(rows: Tensor, weights: Tensor | None = None) -> Tensor:
    """Inner products of all pairs of rows; float64, as rows that are nearly alike make it singular.

    Parameters
    ----------
    rows
        (count, pixels).
    weights
        Of the pixels; None for 1.
    """
    total = rows.new_zeros(len(rows), len(rows), dtype=torch.float64)
    for first in range(0, rows.shape[1], _PIXELS):
        part = rows[:, first : first + _PIXELS].double()
        total += (part if weights is None else part * weights[first : first + _PIXELS]) @ part.T
    return total


def _dot(x: Tensor, y: Tensor) -> Tensor:
    """Inner product; float64."""
    return torch.dot(x.reshape(-1), y.reshape(-1)).double()


def _squares(values: Tensor) -> float:
    return float(_dot(values, values))
