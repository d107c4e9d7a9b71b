"""ADMM that fits the measurement in its linear step, by preconditioned conjugate gradients."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import PassSums, SplitState
from nolens.operators import FiniteDifference
from nolens.solvers.admm_state import AdmmState, Penalties
from nolens.solvers.functionals import OpponentL1
from nolens.solvers.linear_step import LinearStep, dot, first_in_frame
from nolens.solvers.problem import Prior, Problem

DATA_STEP_RELAXATION = 1.5
"""α where no other is given."""
_START_SCENE = 0.02
_START_VARIATION = 5.0
"""Penalties to start with: that of the scene, and that of its variation over τ and the scene's
level. Small ones let the scene follow the data at once, of whatever sign it becomes."""
_REFINING = 4.0
"""Factor on those of a cold start, where the scene comes from larger pixels."""
_START_DARK, _FOLLOWING_DARK = 0.05, 0.3
"""Those of a scene that does not fill the view, of a cold start and of a frame that follows: with a
small one, what the sensor hardly sees of it goes astray for tens of frames."""


def data_step_start(
    problem: Problem, state: AdmmState, *, follows: bool = False, refines: bool = False
) -> Penalties:
    """Penalties of a cold start, or where the scene comes from elsewhere.

    Its level is its mean where it fills the view; in the dark it is the root mean square of
    a scene that A passes on as it is, 1/√N for N pixels.

    Parameters
    ----------
    problem, state
        To start.
    follows
        Whether the scene is another frame's.
    refines
        Whether it is this measurement's on larger pixels, and fills the view.
    """
    if refines:
        first, second, third = data_step_start(problem, state)
        return first, _REFINING * second, _REFINING * third
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
    and the slow part of a scene hardly changes what is. A `LinearStep` goes on from
    the scene before, a little each time (inexact ADMM, `eckstein2017`).

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
        self._linear = LinearStep(problem, self.a_w, varied=self._tv)

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement."""
        self._linear.measure(problem)
        self._problem = problem

    @property
    def v(self) -> Tensor:
        """The scene of the linear step."""
        return self._linear.v

    @v.setter
    def v(self, scene: Tensor) -> None:
        self._linear.v = scene

    def renew_residual(self) -> None:
        """Compute the residual anew, of which steps lose a little each."""
        self._linear.renew_residual()

    def write(self, split: SplitState) -> None:
        """Write the splits u and w with their multipliers, and x on the valid pixels."""
        top, left, height, width = split.sensor
        light = self._problem.data[0] - self._linear.residual[0]
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
        self._linear.solve(target, penalties)
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
        first = first_in_frame(problem)
        size = scene[2] + first[0], scene[3] + first[1]
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


def _squares(values: Tensor) -> float:
    return float(dot(values, values))
