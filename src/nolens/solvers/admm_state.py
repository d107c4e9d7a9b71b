"""The state of a run of ADMM: what the next iteration needs, its penalties and their balance."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace

import torch
from torch import Tensor

from nolens.camera.values import all_finite
from nolens.errors import DataError
from nolens.kernels import PassSums, SplitState, in_large_pages, irfft2, rfft2
from nolens.operators import FiniteDifference
from nolens.solvers.problem import Prior, Problem

Penalties = tuple[float, float, float]
"""μ₁, μ₂, μ₃ of the splits x = Mv, u = Ψv, w = v."""

CHECK_EVERY = 4
"""Iterations from one convergence check to the next: residuals, balance, stop."""

_START: Penalties = (0.02, 2.0, 1.0)

_ARRAYS = ("measured", "rows", "columns", "scene")
_SUMS = tuple(each.name for each in fields(PassSums))
_SUM_COUNT = 15
"""Numbers of one `PassSums`."""
_SMALLEST = 1e-15
"""Least penalty of a saved state; balanced ones stay near one."""
_MOST_ITERATIONS = 10**9


@dataclass(frozen=True)
class Balance:
    r"""Balances penalties until multipliers and splits move alike.

    For each split, Rᵢ = ‖Δdᵢ‖ / ‖Δxᵢ‖ compares the way that its scaled multiplier went in an
    iteration with the way that the split itself went, and R does so for all of them, in the
    metric of the penalties: R² = Σμᵢ‖Δdᵢ‖² / Σμᵢ‖Δxᵢ‖². Residual balancing (`boyd2011`,
    § 3.4.1; `he2000`) keeps such a ratio near one. Here, after every check,

    - all penalties grow by `growth` while R exceeds `target`: they start small, where the
      measurement is met at once, and end where the splits agree;
    - each is multiplied by (Rᵢ/R)^`rate`, at most by `limit`, so that no split is left behind.

    After `span` iterations the penalties stay as they are, without which ADMM need not
    converge (`he2000`). `docs/decisions/0002-penalties.md` has what was measured.

    Of a scene that does not fill the view, with the measurement in the linear step, R may reach
    `dark_target` first: larger penalties would hold what A hardly sees where it is (decision 18).
    """

    growth: float = 1.31
    target: float = 0.7
    dark_target: float = 1.5
    rate: float = 0.34
    limit: float = 1.46
    span: int = 100

    @property
    def in_the_dark(self) -> "Balance":
        """The same with the other target."""
        return replace(self, target=self.dark_target)

    def next(self, penalties: Penalties, sums: list[PassSums], iteration: int) -> Penalties:
        """Penalties after `iteration`, from the sums of every channel's last pass."""
        turned, moved = (
            [sum(getattr(each, name)[k] for each in sums) for k in range(3)]
            for name in ("multiplier_change", "change")
        )
        first, second, third = self.balanced(penalties, turned, moved, iteration)
        return first, second, third

    def balanced(
        self, penalties: Sequence[float], turned: list[float], moved: list[float], iteration: int
    ) -> list[float]:
        """Penalties after `iteration`, from ‖Δd‖² and ‖Δx‖² of every split."""
        if iteration > self.span:
            return list(penalties)
        all_turned = sum(mu * d for mu, d in zip(penalties, turned, strict=True))
        all_moved = sum(mu * x for mu, x in zip(penalties, moved, strict=True))
        if not all_turned > 0:
            return list(penalties)
        ratio = math.sqrt(all_turned / all_moved) if all_moved > 0 else math.inf
        growth = self.growth if ratio > self.target else 1.0
        return [
            mu * growth * self._step(d, x, ratio)
            for mu, d, x in zip(penalties, turned, moved, strict=True)
        ]

    def _step(self, turned: float, moved: float, ratio: float) -> float:
        if turned == 0 or moved == 0:
            return 1.0
        step = math.pow(math.sqrt(turned / moved) / ratio, self.rate)
        return min(max(step, 1 / self.limit), self.limit)


@dataclass
class AdmmState:
    """The splits of every channel, the penalties and the sums that the balance goes by.

    `admm` advances the state that it is given, in place. A state fits every problem of the same
    sizes and prior: it is in normalised units, so that of one frame is a start for the next.

    Parameters
    ----------
    splits
        Of every channel.
    penalties
        μ₁, μ₂, μ₃ of the next solve.
    sums
        Of every channel, from the last convergence check; empty before the first.
    iteration
        How many were done.
    fills_view
        Whether a uniform scene explains most of the measurement.
    differences
        Memory of the splits' rows and columns, (channels, 2, height, width).
    """

    splits: list[SplitState]
    penalties: Penalties
    sums: list[PassSums]
    iteration: int = 0
    fills_view: bool = False
    differences: Tensor = field(default_factory=lambda: torch.empty(0, 2, 0, 0), repr=False)

    @classmethod
    def cold(cls, problem: Problem, penalties: Penalties | None = None) -> "AdmmState":
        """Start of a run: the uniform scene that fits best where that explains most, or zero."""
        levels = problem.uniform_levels()
        scenes = [problem.data.new_full(problem.scene_shape[1:], level) for level in levels]
        return cls._at(problem, scenes, _START if penalties is None else penalties, levels)

    @classmethod
    def at(cls, problem: Problem, scene: Tensor, penalties: Penalties) -> "AdmmState":
        """Start of a run from a scene, with multipliers of zero.

        Parameters
        ----------
        problem
            To be solved.
        scene
            `(channels, height, width)` of the scene's pixels, normalised.
        penalties
            To start with.
        """
        return cls._at(problem, list(scene), penalties, problem.uniform_levels())

    @classmethod
    def _at(
        cls, problem: Problem, scenes: list[Tensor], penalties: Penalties, levels: list[float]
    ) -> "AdmmState":
        padded = problem.forward.geometry.padded
        shape = (problem.channels, 2, *(padded if problem.varied else (0, 0)))
        differences = problem.data.new_empty(shape)
        splits = []
        for channel, each in enumerate(scenes):
            scene = problem.forward.embed(each)
            if problem.in_linear_step:
                measured = problem.single(channel).forward(each[None])[0]
            else:
                measured = irfft2(rfft2(scene) * problem.transfer(channel), padded)
            if problem.varied:
                differences[channel] = FiniteDifference(padded)(scene)
            splits.append(_split(problem, channel, measured, scene, differences[channel]))
        penalties = _of_splits(penalties, splits)
        return cls(splits, penalties, [], fills_view=min(levels) > 0, differences=differences)

    def move(self, problem: Problem, scene: Tensor) -> None:
        """Start from another scene of the same problem, as `at` does.

        Parameters
        ----------
        problem, scene
            As `at` takes them.
        """
        # Two of them at once would be half as much memory again.
        self.splits, self.differences = [], self.differences.new_empty(0, 2, 0, 0)
        moved = AdmmState.at(problem, scene, self.penalties)
        self.splits, self.differences = moved.splits, moved.differences

    def restart(self, penalties: Penalties) -> None:
        """Start with other penalties; the multipliers are still zero."""
        self.penalties = _of_splits(penalties, self.splits)

    def renew(self, problem: Problem, penalties: Penalties) -> None:
        """Go on from here with another measurement of the same sizes, and count anew.

        Parameters
        ----------
        problem
            With the measurement.
        penalties
            To go on with; the multipliers μd are kept.
        """
        penalties = _of_splits(penalties, self.splits)
        for channel, split in enumerate(self.splits):
            split.data, split.valid = _measurement(problem, channel)
            if penalties != self.penalties:
                split.rescale_(self.penalties, penalties)
        self.penalties, self.sums, self.iteration = penalties, [], 0

    def weigh(self, problem: Problem) -> None:
        """Go on with the weight of another problem; neither it nor that so far may be zero."""
        for split in self.splits:
            if problem.prior is Prior.L1:
                split.l1 = problem.tau
            elif problem.prior is not Prior.NONE:
                split.tv = problem.tau

    def residual(self, problem: Problem) -> float:
        """‖b − x‖ / ‖b‖ of a measurement that is yet to be solved for, all channels as measured.

        Parameters
        ----------
        problem
            With the measurement, of the same sizes; x is the light on the sensor so far.
        """
        missed = total = 0.0
        for channel, split in enumerate(self.splits):
            data, weight = problem.data[channel], float(problem.scale[channel]) ** 2
            apart = torch.where(problem.valid[channel], data - split.light, 0)
            missed += weight * float(apart.square().sum())
            total += weight * float(data.square().sum())
        return math.sqrt(missed / total)

    def fraction_on_sensor(self) -> float:
        """Fraction of the scene's light in the padded shape that falls onto the sensor so far."""
        total = on_sensor = 0.0
        for split in self.splits:
            total += float(split.measured.sum())
            on_sensor += float(split.light.sum())
        return on_sensor / total if total > 0 else 1.0

    def scene(self) -> Tensor:
        """The split w of every channel on the scene's pixels: non-negative; normalised."""
        return torch.stack([each.estimate(self.penalties[2]) for each in self.splits])

    def arrays(self) -> dict[str, Tensor]:
        """All of it as named tensors, for a state file."""
        arrays = {
            f"{name}_{channel}": getattr(split, name)
            for channel, split in enumerate(self.splits)
            for name in _ARRAYS
        }
        sums = [
            torch.cat(
                [
                    torch.tensor(getattr(each, name), dtype=torch.float64).reshape(-1)
                    for name in _SUMS
                ]
            )
            for each in self.sums
        ]
        return {
            **arrays,
            "penalties": torch.tensor(self.penalties, dtype=torch.float64),
            "sums": torch.stack(sums) if sums else torch.zeros(0, dtype=torch.float64),
            "iteration": torch.tensor(self.iteration),
            "fills_view": torch.tensor(self.fills_view),
        }

    def restore_(self, arrays: Mapping[str, Tensor]) -> None:
        """Take up a state that `arrays` gave, of the same problem.

        Raises
        ------
        DataError
            If it is not the state of a problem of these sizes, or holds what no run does.
        """
        for channel, split in enumerate(self.splits):
            for name in _ARRAYS:
                saved, here = arrays.get(f"{name}_{channel}"), getattr(split, name)
                if saved is None or saved.shape != here.shape:
                    was = "none" if saved is None else _size(saved)
                    raise DataError(
                        f"the state's array {name} of channel {channel} is {was}, and the problem "
                        f"needs {_size(here)}: it is the state of another problem"
                    )
                if not all_finite(saved):
                    raise DataError(
                        f"the state's array {name} of channel {channel} holds NaN or infinity"
                    )
                here.copy_(saved)
        penalties = _numbers(arrays, "penalties", (3,))
        needed = [mu > 0 for mu in self.penalties]
        if [_SMALLEST <= mu <= 1 / _SMALLEST for mu in penalties] != needed:
            raise DataError(f"the state's penalties are {penalties}: μ₁, μ₂ and μ₃ are above zero")
        first, second, third = penalties
        width = _SUM_COUNT if arrays.get("sums", torch.zeros(0)).numel() else 0
        sums = _numbers(arrays, "sums", (len(self.splits), width) if width else (0,))
        (iteration,) = _numbers(arrays, "iteration", ())
        if not 0 <= iteration <= _MOST_ITERATIONS:
            raise DataError(f"the state's iteration is {iteration:g}")
        if any(each < 0 for each in sums):
            raise DataError("the state's sums of squares are below zero")
        self.penalties = first, second, third
        self.sums = [PassSums.of(sums[at : at + width]) for at in range(0, len(sums), width or 1)]
        self.iteration = int(iteration)
        self.fills_view = bool(_numbers(arrays, "fills_view", ())[0])


def _numbers(arrays: Mapping[str, Tensor], name: str, shape: tuple[int, ...]) -> list[float]:
    """Values of an array that is to have this shape."""
    saved = arrays.get(name)
    if saved is None or saved.shape != shape or not all_finite(saved):
        raise DataError(f"the state's array {name} is missing, of another size, or not finite")
    return [float(value) for value in saved.flatten()]


def _size(array: Tensor) -> str:
    return "×".join(str(n) for n in array.shape)


def _split(
    problem: Problem, channel: int, measured: Tensor, scene: Tensor, differences: Tensor
) -> SplitState:
    geometry = problem.forward.geometry
    data, valid = _measurement(problem, channel)
    return SplitState(
        data=data,
        valid=valid,
        sensor=geometry.sensor,
        support=geometry.scene,
        tv=problem.tau if problem.varied else 0.0,
        isotropic=problem.prior is Prior.ISOTROPIC_TV,
        l1=problem.tau if problem.prior is Prior.L1 else 0.0,
        measured=in_large_pages(measured),
        rows=differences[0],
        columns=differences[1],
        scene=in_large_pages(scene),
    )


def _of_splits(penalties: Penalties, splits: list[SplitState]) -> Penalties:
    """Penalties of the splits that there are: without total variation there is no u."""
    first, second, third = penalties
    return first, second if splits[0].tv > 0 else 0.0, third


def _measurement(problem: Problem, channel: int) -> tuple[Tensor, Tensor]:
    valid = problem.valid[channel].to(torch.uint8)
    return problem.data[channel].contiguous(), valid.contiguous()
