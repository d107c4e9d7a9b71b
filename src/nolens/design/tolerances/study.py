"""A study of tolerances: many cameras drawn at random, their yield, and what may be allowed."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import torch
from scipy.special import ndtri
from torch import Tensor

from nolens.amounts import amount, finite_or_none
from nolens.camera import Camera, LoadedCamera
from nolens.design.tolerances.models import (
    RayModel,
    WaveModel,
    check_possible,
    criterion_of,
    largest_possible,
    leaves_thickness,
)
from nolens.design.tolerances.parameters import Parameter, draw, find, variables
from nolens.design.tolerances.patch import Patch
from nolens.design.tolerances.sensitivity import Criterion, Response, evaluate, respond, sweep
from nolens.design.tolerances.sharpness import Limit, Sharpness
from nolens.errors import OptionError
from nolens.kernels.threads import one_thread
from nolens.twin import Light, colours_of, preview_model

LEVELS = (0.98, 0.90, 0.80, 0.50, 0.10)
"""Fractions of all cameras for which a level is given."""
_PRECISION = 0.01
MOST_STEPS = 14
"""Yields that `largest_tolerance` asks for, where the answer is a tenth of the bound or more."""
_WAVELENGTHS = 3
_AT_ONCE = 1000
_CURVES = 3
_POINTS = 9

Stop = Callable[[int, int], bool]
"""Called with the number of cameras that are done, and of all; True ends the work."""


def levels(figures: Tensor, *, smaller_is_better: bool) -> dict[float, float]:
    """Figures that fractions of all cameras meet or do better than.

    Parameters
    ----------
    figures
        Of the trials.
    smaller_is_better
        Which way is better.

    Returns
    -------
    dict
        For each of `LEVELS`, the figure of the camera that this fraction, rounded up to whole
        cameras, is not worse than.
    """
    ordered = figures.sort(descending=not smaller_is_better).values
    return {level: float(ordered[math.ceil(level * len(ordered) - 1e-9) - 1]) for level in LEVELS}


@dataclass(frozen=True)
class Yield:
    """Fraction of cameras that meet a limit.

    Parameters
    ----------
    passed, trials
        Cameras that met it, of how many.
    """

    passed: int
    trials: int

    @classmethod
    def of(cls, figures: Tensor, limit: float, *, smaller_is_better: bool) -> "Yield":
        """Count the trials that meet a limit."""
        met = figures <= limit if smaller_is_better else figures >= limit
        return cls(int(met.sum()), len(figures))

    @property
    def fraction(self) -> float:
        """Fraction of the trials."""
        return self.passed / self.trials

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        r"""Wilson's interval for the fraction of all cameras (`wilson1927`).

        .. math::
            \frac{p + z^2/2n \pm z \sqrt{p(1-p)/n + z^2/4n^2}}{1 + z^2/n}

        with p the fraction of n trials and z the normal quantile of the confidence.
        """
        n, p = self.trials, self.fraction
        z = float(ndtri(0.5 + confidence / 2))
        middle = p + z * z / (2 * n)
        half = z * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        scale = 1 + z * z / n
        # At 0 and 1 the ends are exact, but for rounding.
        low = 0.0 if self.passed == 0 else (middle - half) / scale
        high = 1.0 if self.passed == n else (middle + half) / scale
        return low, high

    def summary(self) -> dict[str, Any]:
        """The counts, the fraction and its interval, in values that JSON has."""
        return {
            "fraction": self.fraction,
            "passed": self.passed,
            "trials": self.trials,
            "interval_95": list(self.interval()),
        }


@dataclass(frozen=True)
class _Allowed:
    """The largest tolerance for a yield, ± in the parameter's unit, and the yield with it.

    The verdict is ``"found"``; ``"impossible"`` where not even a tolerance of zero gives the yield,
    and ``"any"`` where the largest one that was tried still does.
    """

    verdict: Literal["found", "impossible", "any"]
    tolerance: float
    reached: Yield


def largest_tolerance(
    yield_with: Callable[[float], Yield], target: float, bound: float
) -> _Allowed:
    """Find the largest tolerance that gives a yield, by bisection to one hundredth of it.

    The same random numbers must serve every tolerance, so that the yield falls as the tolerance
    grows; where it also rises somewhere, one of the places is found at which it crosses `target`.

    Parameters
    ----------
    yield_with
        Yield with a tolerance.
    target
        The yield, from 0 to 1.
    bound
        Largest tolerance to be tried.
    """
    reached = yield_with(0.0)
    if reached.fraction < target:
        return _Allowed("impossible", 0.0, reached)
    at_bound = yield_with(bound)
    if at_bound.fraction >= target:
        return _Allowed("any", bound, at_bound)
    low, high = 0.0, bound
    while high - low > _PRECISION * high and high > 1e-9 * bound:
        middle = (low + high) / 2
        at_middle = yield_with(middle)
        if at_middle.fraction >= target:
            low, reached = middle, at_middle
        else:
            high = middle
    return _Allowed("found", low, reached)


@dataclass(frozen=True)
class BudgetLine:
    """One line of a tolerance budget.

    Parameters
    ----------
    parameter
        Its name.
    nominal
        Its middle value.
    allowed
        ±.
    unit
        Of both; empty for an index.
    effect
        What the criterion does at − and + that, as text.
    """

    parameter: str
    nominal: float
    allowed: float
    unit: str
    effect: str


@dataclass(frozen=True)
class Study:
    """Sensitivities, trials and what follows from them.

    Parameters
    ----------
    sharpness
        The criterion.
    response
        Around the middle of all parameters.
    cameras
        Cameras that were drawn, (trials, parameters).
    figures
        Their criterion, (trials,); infinite where nothing could be measured.
    curves
        By the name of a parameter, its values and the criterion at them.
    limit
        What a camera must meet; None where nobody asked.
    solved
        The parameter whose tolerance was asked for, the yield that it is for, and the result.
    """

    sharpness: Sharpness
    response: Response
    cameras: Tensor
    figures: Tensor
    curves: dict[str, tuple[Tensor, Tensor]]
    limit: float | None = None
    solved: tuple[Parameter, float, _Allowed] | None = None

    @property
    def levels(self) -> dict[float, float]:
        """See `levels`."""
        return levels(self.figures, smaller_is_better=self.sharpness.smaller_is_better)

    @property
    def passed(self) -> Yield | None:
        """Cameras that met the limit."""
        if self.limit is None:
            return None
        better = self.sharpness.smaller_is_better
        return Yield.of(self.figures, self.limit, smaller_is_better=better)

    @property
    def budget(self) -> tuple[BudgetLine, ...]:
        """Lines for the process sheet, the worst offender first."""
        unit = self.sharpness.unit
        return tuple(
            BudgetLine(
                row.parameter.name,
                row.parameter.middle,
                row.parameter.tolerance,
                row.parameter.unit,
                f"{self.sharpness.name} {amount(row.minus, digits=2, sign=True)} / "
                f"{amount(row.plus, unit, digits=2, sign=True)}",
            )
            for row in self.response.sensitivities
        )

    def summary(self) -> dict[str, Any]:
        """All figures in values that JSON has; None where there is no finite one."""
        prediction = self.response.predict()
        finite = self.figures[self.figures.isfinite()]
        summary: dict[str, Any] = {
            "nominal": self.response.nominal,
            "sensitivities": [row.summary() for row in self.response.sensitivities],
            "budget": [asdict(line) for line in self.budget],
            "prediction": {
                "mean": finite_or_none(prediction.mean),
                "root_sum_square_sigma": finite_or_none(prediction.linear_sigma),
                "second_order_sigma": finite_or_none(prediction.sigma),
            },
            "trials": len(self.figures),
            "not_measurable": len(self.figures) - len(finite),
            "mean": finite_or_none(float(finite.mean())) if len(finite) else None,
            "sigma": finite_or_none(float(finite.std())) if len(finite) > 1 else None,
            "levels": {f"{100 * k:.0f} %": finite_or_none(v) for k, v in self.levels.items()},
            "limit": self.limit,
        }
        if self.passed is not None:
            summary["yield"] = self.passed.summary()
        if self.solved is not None:
            parameter, target, allowed = self.solved
            summary["solved"] = {
                "parameter": parameter.name,
                "target_yield": target,
                "verdict": allowed.verdict,
                "tolerance": allowed.tolerance,
                "unit": parameter.unit,
                "reached": allowed.reached.summary(),
            }
        return summary


@dataclass(frozen=True)
class StudyPlan:
    """A study that has been checked and can be computed.

    Parameters
    ----------
    camera
        The description.
    parameters
        What varies.
    sharpness
        The criterion's kind.
    patch
        Of the mask.
    criterion
        From cameras to their figures.
    at_once
        Cameras that are computed in one portion.
    bytes_at_once
        Memory that a portion takes, beside the program.
    cameras
        Those that are drawn, (trials, parameters).
    seed
        Of the random numbers.
    limit
        What a good camera meets.
    target
        Number of the parameter whose tolerance is asked for, and the yield that it is for.
    """

    camera: Camera
    parameters: tuple[Parameter, ...]
    sharpness: Sharpness
    patch: Patch
    criterion: Criterion
    at_once: int
    bytes_at_once: float
    cameras: Tensor
    seed: int
    limit: Limit | None = None
    target: tuple[int, float] | None = None

    @classmethod
    def of(
        cls,
        loaded: LoadedCamera,
        parameters: tuple[Parameter, ...],
        sharpness: Sharpness,
        light: Light,
        *,
        rays: bool,
        trials: int,
        seed: int,
        limit: Limit | None,
        solve: tuple[str, float] | None,
    ) -> "StudyPlan":
        """Check all that can be checked before anything takes long.

        Parameters
        ----------
        rays
            Whether lenslets are modelled by rays, in place of the twin's waves.
        solve
            Name of the parameter whose tolerance is asked for, and the yield that it is for.

        Raises
        ------
        OptionError
            If the limit, the parameter, the tolerances or the camera cannot be used.
        """
        camera = loaded.camera
        if limit is not None:
            limit.value(sharpness, 1.0)
        target = None
        if solve is not None:
            target = _number_of(solve[0], parameters, camera), solve[1]
        cameras = draw(parameters, trials, seed)
        check_possible(camera, parameters, cameras)
        preview_model(loaded)  # Refuses a relief that is coarser than it must be.
        patch = Patch.of(loaded)
        sharpness.check(patch.twin.sensor_pitch_um, patch.lenslets.pitch_um)
        channels = colours_of(patch.twin, light, _WAVELENGTHS)
        colours = channels[len(channels) // 2]
        model: WaveModel | RayModel
        if rays:
            model = RayModel(patch, sharpness, sum(nm * weight for nm, weight in colours))
            at_once, size = _AT_ONCE, 0.0
        else:
            at_once = torch.get_num_threads()
            model = WaveModel(patch, sharpness, colours, at_once)
            size = at_once * model.bytes_per_camera
        criterion = criterion_of(model, camera, tuple(each.name for each in parameters))
        return cls(
            camera,
            parameters,
            sharpness,
            patch,
            criterion,
            at_once,
            size,
            cameras,
            seed,
            limit,
            target,
        )

    @property
    def trials(self) -> int:
        """How many cameras are drawn."""
        return len(self.cameras)

    def run(self, progress: Callable[[str, float], None], stop: Stop) -> tuple[Study, bool]:
        """Compute all.

        Parameters
        ----------
        progress
            Called with the part of the work, and the fraction of it that is done.
        stop
            Called after every portion of the trials.

        Returns
        -------
        tuple
            The study, and whether it was stopped early.

        Raises
        ------
        OptionError
            If the camera as it is described shows nothing to measure, or no camera meets the limit.
        """
        with one_thread():
            response = respond(
                self.criterion,
                self.parameters,
                smaller_is_better=self.sharpness.smaller_is_better,
                at_once=self.at_once,
                progress=partial(progress, "sensitivities"),
            )
            limit = self._limit(response)
            curves = self._curves(response, partial(progress, "curves"))
            figures = self._figures(self.cameras, lambda done: stop(done, self.trials))
            stopped, solved = len(figures) < self.trials, None
            if self.target is not None and limit is not None and not stopped:
                number, target = self.target
                allowed = self._allowed(number, target, limit, stop)
                stopped = allowed is None
                if allowed is not None:
                    solved = self.parameters[number], target, allowed
        study = Study(self.sharpness, response, self.cameras, figures, curves, limit, solved)
        return study, stopped

    def _figures(self, cameras: Tensor, stop: Callable[[int], bool]) -> Tensor:
        return evaluate(self.criterion, cameras, at_once=self.at_once, stop=stop)

    def _limit(self, response: Response) -> float | None:
        """The limit, if any of the cameras that were computed so far meets it."""
        if not math.isfinite(response.nominal):
            raise OptionError(
                "the pattern of the camera as it is described has no line that could be measured: "
                "choose another --criterion, or a thickness nearer to the focus"
            )
        if self.limit is None:
            return None
        sharpness, best, unit = self.sharpness, response.best, self.sharpness.unit
        limit = self.limit.value(sharpness, response.nominal)
        if (limit < best) if sharpness.smaller_is_better else (limit > best):
            raise OptionError(
                f"--limit {self.limit} cannot be reached: the nominal camera has a "
                f"{sharpness.name} of {amount(response.nominal, unit, digits=4)}, and the best "
                f"that the tolerances make of it is {amount(best, unit, digits=4)}; give a limit "
                "of that or " + ("more" if sharpness.smaller_is_better else "less")
            )
        return limit

    def _curves(
        self, response: Response, progress: Callable[[float], None]
    ) -> dict[str, tuple[Tensor, Tensor]]:
        """Criterion over each of the worst offenders."""
        varied = [row.parameter for row in response.sensitivities if row.parameter.tolerance > 0]
        worst, curves = varied[:_CURVES], {}
        for done, each in enumerate(worst):
            progress(done / len(worst))
            number = self.parameters.index(each)
            curves[each.name] = sweep(self.criterion, self.parameters, number, _POINTS)
        return curves

    def _allowed(self, number: int, target: float, limit: float, stop: Stop) -> _Allowed | None:
        """Largest tolerance of one parameter for a yield; None where a person stopped it."""
        varied = self.parameters[number]
        if varied.tolerance == 0:
            varied = varied.with_tolerance(1.0)

        def cameras(tolerance: float) -> Tensor:
            one = varied.with_tolerance(tolerance)
            others = (*self.parameters[:number], one, *self.parameters[number + 1 :])
            return draw(others, self.trials, self.seed)

        possible = variables(self.camera)[varied.name]
        drawn = cameras(varied.tolerance)[:, number]
        bound = 0.999 * largest_possible(possible, varied, drawn)
        while not leaves_thickness(self.camera, self.parameters, cameras(bound)):
            bound /= 2
        steps = 0

        def yield_with(tolerance: float) -> Yield:
            nonlocal steps
            total, before = max(MOST_STEPS, steps + 1) * self.trials, steps * self.trials
            figures = self._figures(cameras(tolerance), lambda done: stop(before + done, total))
            if len(figures) < self.trials:
                raise _StoppedError
            steps += 1
            return Yield.of(figures, limit, smaller_is_better=self.sharpness.smaller_is_better)

        try:
            return largest_tolerance(yield_with, target, bound)
        except _StoppedError:
            return None


class _StoppedError(Exception):
    """A person stopped the search between two trials."""


def _number_of(name: str, parameters: tuple[Parameter, ...], camera: Camera) -> int:
    """Place of a parameter among those that vary."""
    full = find(variables(camera), camera, name).name
    names = [each.name for each in parameters]
    if full not in names:
        raise OptionError(
            f"--solve {name}: it is not among the parameters of the tolerances, which are "
            f"{', '.join(names)}: add it, with any tolerance and its distribution"
        )
    return names.index(full)
