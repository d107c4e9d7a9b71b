"""Where a run of ADMM stands: what the next iteration needs, and what a state file holds."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields

import torch
from torch import Tensor

from nolens.camera.finite import all_finite
from nolens.errors import DataError
from nolens.kernels import PassSums, SplitState, in_large_pages, irfft2, rfft2
from nolens.operators import FiniteDifference
from nolens.solvers.penalties import START, Penalties
from nolens.solvers.problem import Prior, Problem

_UNIFORM_START = 0.9
"""Fraction of the data that a uniform scene must explain for the iteration to start from it."""
_ARRAYS = ("measured", "rows", "columns", "scene")
_SUMS = tuple(field.name for field in fields(PassSums))
_SUM_COUNT = 15
"""Numbers of one `PassSums`."""
_SMALLEST = 1e-15
"""Least penalty of a saved state; balanced ones stay near one."""
_MOST_ITERATIONS = 10**9


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
        Of every channel, from the last iteration that was looked at; empty before the first.
    iteration
        How many were done.
    fills_view
        Whether a uniform scene explains most of the measurement.
    """

    splits: list[SplitState]
    penalties: Penalties
    sums: list[PassSums]
    iteration: int = 0
    fills_view: bool = False

    @classmethod
    def cold(cls, problem: Problem, penalties: Penalties | None = None) -> "AdmmState":
        """Start of a run: the uniform scene that fits best where that explains most, or zero."""
        levels = _uniform_levels(problem)
        scenes = [problem.data.new_full(problem.scene_shape[1:], level) for level in levels]
        return cls._at(problem, scenes, START if penalties is None else penalties, levels)

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
        return cls._at(problem, list(scene), penalties, _uniform_levels(problem))

    @classmethod
    def _at(
        cls, problem: Problem, scenes: list[Tensor], penalties: Penalties, levels: list[float]
    ) -> "AdmmState":
        geometry = problem.forward.geometry
        splits = []
        for channel, each in enumerate(scenes):
            scene = problem.forward.embed(each)
            measured = irfft2(rfft2(scene) * problem.transfer(channel), geometry.period)
            splits.append(_split(problem, channel, measured, scene))
        return cls(splits, _of_splits(penalties, splits), [], fills_view=min(levels) > 0)

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

    def residual(self, problem: Problem) -> float:
        """‖b − x‖ / ‖b‖ of a measurement that is yet to be solved for, all channels as measured.

        Parameters
        ----------
        problem
            With the measurement, of the same sizes; x is the light on the sensor as it stands.
        """
        missed = total = 0.0
        for channel, split in enumerate(self.splits):
            top, left, height, width = split.sensor
            light = split.measured[top : top + height, left : left + width]
            data, weight = problem.data[channel], float(problem.scale[channel]) ** 2
            apart = torch.where(problem.valid[channel], data - light, 0)
            missed += weight * float(apart.square().sum())
            total += weight * float(data.square().sum())
        return math.sqrt(missed / total)

    def kept(self) -> float:
        """Fraction of the scene's light in the period that falls onto the sensor, as it stands."""
        total = on_sensor = 0.0
        for split in self.splits:
            top, left, height, width = split.sensor
            total += float(split.measured.sum())
            on_sensor += float(split.measured[top : top + height, left : left + width].sum())
        return on_sensor / total if total > 0 else 1.0

    def move_(self, problem: Problem, change: Tensor) -> None:
        """Add to the scene what another method found: to every split, with its multiplier kept.

        On the sensor x stays: it is held by the measurement, and v comes to it.

        Parameters
        ----------
        problem
            Of this state.
        change
            `(channels, height, width)` of the scene's pixels, normalised.
        """
        geometry = problem.forward.geometry
        top, left, height, width = geometry.sensor
        for channel, split in enumerate(self.splits):
            scene = problem.forward.embed(change[channel])
            image = irfft2(rfft2(scene) * problem.transfer(channel), geometry.period)
            image[top : top + height, left : left + width] = 0
            split.measured += image
            split.scene += scene
            if split.tv > 0:
                rows, columns = FiniteDifference(geometry.period)(scene)
                split.rows += rows
                split.columns += columns

    def scene(self) -> Tensor:
        """The split w of every channel on the scene's pixels: non-negative; normalised."""
        return torch.stack([each.estimate(self.penalties[2]) for each in self.splits])

    def arrays(self) -> dict[str, Tensor]:
        """All of it as named tensors, for a state file."""
        held = {
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
            **held,
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


def _split(problem: Problem, channel: int, measured: Tensor, scene: Tensor) -> SplitState:
    geometry = problem.forward.geometry
    tv = problem.tau if problem.prior in (Prior.TV, Prior.ISOTROPIC_TV) else 0.0
    gradient = FiniteDifference(geometry.period)(scene) if tv > 0 else scene.new_empty(2, 0, 0)
    data, valid = _measurement(problem, channel)
    return SplitState(
        data=data,
        valid=valid,
        sensor=geometry.sensor,
        support=geometry.scene,
        tv=tv,
        isotropic=problem.prior is Prior.ISOTROPIC_TV,
        l1=problem.tau if problem.prior is Prior.L1 else 0.0,
        measured=in_large_pages(measured),
        rows=in_large_pages(gradient[0]),
        columns=in_large_pages(gradient[1]),
        scene=in_large_pages(scene),
    )


def _of_splits(penalties: Penalties, splits: list[SplitState]) -> Penalties:
    """Penalties of the splits that there are: without total variation there is no u."""
    first, second, third = penalties
    return first, second if splits[0].tv > 0 else 0.0, third


def _measurement(problem: Problem, channel: int) -> tuple[Tensor, Tensor]:
    valid = problem.valid[channel].to(torch.uint8)
    return problem.data[channel].contiguous(), valid.contiguous()


def _uniform_levels(problem: Problem) -> list[float]:
    """Level c of each channel that minimises ‖b − c·CM1‖², or zeros where that explains little."""
    ones = problem.data.new_ones(problem.scene_shape)
    glow = torch.where(problem.valid, problem.forward(ones), 0).double()
    overlap = (glow * problem.data).sum(dim=(-2, -1))
    levels = overlap / glow.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    explained = float((levels * overlap).mean())  # of ‖b‖² = 1
    return levels.tolist() if explained > _UNIFORM_START else [0.0] * problem.channels
