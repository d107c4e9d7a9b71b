"""ADMM that fits the measurement in its linear step, by preconditioned conjugate gradients."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.kernels import (
    Coupling,
    PassSums,
    Shrinkage,
    SplitState,
    add_pulls_,
    move_differences_,
    scale_multipliers_,
)
from nolens.solvers.admm_state import AdmmState, Penalties
from nolens.solvers.functionals import OpponentL1
from nolens.solvers.linear_step import LinearStep, dot, first_in_frame
from nolens.solvers.problem import Prior, Problem

_Sums = tuple[float, float, float, float]
_Proximal = Callable[[Tensor], Tensor]

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
    state
        Where to start from; `write` brings it up to date, the split x where the sensor is.
    relaxation
        α in (0, 2).
    """

    def __init__(self, problem: Problem, state: AdmmState, relaxation: float) -> None:
        self._penalties, self._relaxation = state.penalties, relaxation
        self._prior, self._varied = problem.prior, problem.varied
        self._tau = problem.tau
        self._l1 = problem.tau if problem.prior is Prior.L1 else 0.0
        self._frame = _Frame.of(problem)
        self._a_u = self._frame.framed_of(state.differences)
        self._channels = [
            _Channel(problem.single(number), split, self._frame)
            for number, split in enumerate(state.splits)
        ]
        for channel in self._channels:
            channel.start(self._w(channel.a_w))

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement of the same sizes, or another weight; both above zero."""
        self._tau = problem.tau
        self._l1 = problem.tau if problem.prior is Prior.L1 else 0.0
        for number, channel in enumerate(self._channels):
            channel.measure(problem.single(number))

    def iterate(self, count: int, penalties: Penalties) -> list[PassSums]:
        """Make so many iterations with these penalties; the sums of every channel's last."""
        self._go_on_with(penalties)
        for _ in range(count - 1):
            self._iterate(counted=False)
        return self._iterate(counted=True)

    def _iterate(self, *, counted: bool) -> list[PassSums]:
        """One iteration; its sums for every channel where they are counted."""
        scenes = self._pulls()  # What the linear step solves for, and after it its solution.
        of_w = list[_Sums]()
        for channel, plane in zip(self._channels, scenes, strict=True):
            channel.solve(plane, self._w, self._penalties)
            of_w += channel.move(plane, self._w, self._relaxation, counted=counted)
        of_u, variation = self._move_u(scenes, counted=counted)
        if not counted:
            return []
        sums = []
        for each, scene, *both in zip(self._channels, scenes, of_u, of_w, strict=True):
            primal, split, change, turned = ((0.0, u, w) for u, w in zip(*both, strict=True))
            residual, magnitude = _squares(each.residual), scene.abs().sum(dtype=torch.float64)
            sums.append(
                PassSums(primal, split, change, turned, residual, variation, float(magnitude))
            )
        return sums

    def write(self, state: AdmmState) -> None:
        """Write the splits u and w with their multipliers, and x on the valid pixels."""
        for channel, split in zip(self._channels, state.splits, strict=True):
            channel.write(split)
        if self._varied and not self._frame.whole:
            self._frame.write_(state.differences, self._a_u)

    def _pulls(self) -> Tensor:
        """μ₂Ψ*q_u on the frame, (channels, height, width)."""
        pulls = self._a_u.new_zeros((len(self._channels), *self._frame.size))
        if self._varied:
            add_pulls_(pulls, self._a_u, self._shrinkage, self._penalties[1])
        return pulls

    def _move_u(self, scenes: Tensor, *, counted: bool) -> tuple[list[list[float]], float]:
        """Move u with its multiplier; `_sums` of every channel, and R(v), mean over channels."""
        if not self._varied:
            return [[0.0] * 4 for _ in scenes], 0.0
        sums, variation = move_differences_(
            self._a_u, scenes, self._shrinkage, self._relaxation, counted=counted
        )
        return sums, variation / len(scenes)

    @property
    def _shrinkage(self) -> Shrinkage:
        """The proximal map of u."""
        step = self._tau / self._penalties[1]
        if self._prior is Prior.COLOUR_TV:
            norm = OpponentL1.of_scene(-4)
            return Shrinkage(Coupling.COLOURS, step, (norm.mean, norm.colour, norm.colour))
        isotropic = self._prior is Prior.ISOTROPIC_TV
        return Shrinkage(Coupling.DIRECTIONS if isotropic else Coupling.NONE, step)

    def _w(self, multiplied: Tensor) -> Tensor:
        """Proximal map of non-negativity, and of the ℓ1 norm."""
        return (multiplied - self._l1 / self._penalties[2]).clamp_min_(0)

    def _go_on_with(self, penalties: Penalties) -> None:
        """Keep splits and multipliers μd with other penalties."""
        if penalties == self._penalties:
            return
        _, second, third = (
            before / after if after > 0 else 1.0
            for before, after in zip(self._penalties, penalties, strict=True)
        )
        if self._varied:
            scale_multipliers_(self._a_u, self._shrinkage, second)
        for channel in self._channels:
            channel.a_w.copy_(torch.lerp(self._w(channel.a_w), channel.a_w, third))
        self._penalties = penalties


class _Channel:
    """One channel: its scene, and its splits with their multipliers.

    Where the scene is the whole padded shape, these are the state's own memory.
    """

    def __init__(self, problem: Problem, split: SplitState, frame: "_Frame") -> None:
        self._problem, self._frame = problem, frame
        self.a_w = frame.scene_of(split.scene)[None]
        if not frame.whole:
            self.a_w = self.a_w.clone()
        self._linear = LinearStep(problem, self.a_w, varied=problem.varied)

    def measure(self, problem: Problem) -> None:
        """Go on with another measurement."""
        self._linear.measure(problem)
        self._problem = problem

    def start(self, scene: Tensor) -> None:
        """Have the linear step go on from a scene."""
        self._linear.v = scene

    @property
    def residual(self) -> Tensor:
        """What counts of b − Av."""
        return self._linear.residual

    def write(self, split: SplitState) -> None:
        """Write the splits u and w with their multipliers, and x on the valid pixels."""
        split.light.copy_(self._problem.data[0] - self.residual[0])
        if not self._frame.whole:
            split.scene.zero_()
            self._frame.scene_of(split.scene).copy_(self.a_w[0])

    def solve(self, target: Tensor, proximal: _Proximal, penalties: Penalties) -> None:
        """Solve for the scene v with μ₂Ψ*q_u on the frame, (height, width), where v goes."""
        wanted = self._frame.unframed(target)[None]
        wanted.add_(proximal(self.a_w).mul_(2).sub_(self.a_w), alpha=penalties[2])
        self._linear.solve(wanted, penalties)
        self._frame.put_(target, self._linear.v)

    def move(
        self, scene: Tensor, proximal: _Proximal, relaxation: float, *, counted: bool
    ) -> list[_Sums]:
        """Move w with its multiplier, by v on the frame; `_sums`, where they are counted."""
        v, w = self._frame.unframed(scene)[None], proximal(self.a_w)
        if not counted:
            self.a_w.add_(v - w, alpha=relaxation)
            return []
        before = self.a_w.clone()
        self.a_w.add_(v - w, alpha=relaxation)
        self._linear.renew_residual()
        return [_sums(v, (self.a_w, proximal(self.a_w)), (before, w))]


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

    @property
    def whole(self) -> bool:
        """Whether the scene is the whole padded shape."""
        return self.first == (0, 0)

    def scene_of(self, array: Tensor) -> Tensor:
        """The scene's pixels of an array of the padded shape."""
        top, left, height, width = self.scene
        return array[..., top : top + height, left : left + width]

    def framed_of(self, array: Tensor) -> Tensor:
        """The frame's pixels of an array of the padded shape, which is itself where it is whole."""
        return array if self.whole or not array.numel() else array[..., self.rows, self.columns]

    def write_(self, array: Tensor, values: Tensor) -> None:
        """The inverse of `framed_of`; zero beside the frame."""
        array.zero_()
        array[..., self.rows, self.columns] = values

    def put_(self, framed: Tensor, scene: Tensor) -> None:
        """Write a scene onto a frame, with zero beside it."""
        if not self.whole:
            framed.zero_()
        self.unframed(framed).copy_(scene[0])

    def unframed(self, framed: Tensor) -> Tensor:
        """The scene's pixels of a frame."""
        (top, left), (_, _, height, width) = self.first, self.scene
        return framed[..., top : top + height, left : left + width]


def _sums(moved: Tensor, now: tuple[Tensor, Tensor], then: tuple[Tensor, Tensor]) -> _Sums:
    """Of a split x = Kv with its multiplier a = x + d: the first four of `PassSums`.

    Parameters
    ----------
    moved
        Kv.
    now, then
        A and x after an iteration, and before.
    """
    (a, x), (a_then, x_then) = now, then
    turned = (a - x).sub_(a_then - x_then)
    return _squares(moved - x), _squares(x), _squares(x - x_then), _squares(turned)


def _squares(values: Tensor) -> float:
    return float(dot(values, values))
