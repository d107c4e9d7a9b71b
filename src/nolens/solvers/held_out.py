r"""The weight of the prior, chosen by pixels of the measurement that are left out of the fit.

Blocks of sensor pixels are left out, the problem is solved for one weight after the other, and each
scene says what it expects on the pixels that it has not seen. Too strong a prior leaves out
detail, too weak a one explains noise: both predict worse. It is cross-validation with one fold
(`stone1974`), and its one-standard-error rule takes the strongest weight that predicts as well as
the best as far as one can tell (`hastie2009`, § 7.10).

What is compared is the prediction's error without its local mean: the slow glow of a scene that
fills the view is what ADMM is late with, and would drown the rest.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Protocol

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.solvers.admm import start_run
from nolens.solvers.admm_state import CHECK_EVERY, AdmmState, Balance, Penalties
from nolens.solvers.problem import Prior, Problem

_SIDE = 4
"""Sensor pixels along a block that is left out."""
_FRACTION, _FRACTION_AT_MOST = 0.05, 0.2
"""Of the blocks that are left out, and of few blocks."""
_AROUND = 4
"""Pixels around each over which the local mean of the residual is taken."""
_BLOCKS, _FEWEST_BLOCKS = 60, 20
"""Blocks that are left out at least, where there are as many, and number below which their errors
say nothing and the noise decides."""
_BY_NOISE = {Prior.TV: 0.6, Prior.ISOTROPIC_TV: 0.6, Prior.L1: 1.0}
"""Weight where only the noise is known, over the noise of a pixel in normalised units."""
_FROM = {Prior.TV: 1.0, Prior.ISOTROPIC_TV: 1.0, Prior.L1: 2.0}
"""First weight that is tried, over the same."""
_RATIO = 2.0
"""Of neighbouring weights."""
_WEIGHTS_AT_MOST = 8
_FIRST_STEPS, _STEPS = 28, 12
"""Iterations with the first weight, at least, and with each that follows."""
_FIRST_AT_MOST, _SETTLED = 100, 0.02
"""Iterations with the first weight at most, and fraction of the squared error by which the last of
them (`_STEPS`) lower it while they go on: later weights would gain by what the first one lacks."""
_LOOSENED = 0.4
"""Factor on the penalties from weight to weight: what they hold has to move again."""
_QUIETEST = 1e-3
"""Noise of a pixel over the measurement's root mean square, below which none is measured: stored
values and float32 are no finer."""
_SURE, _LIKELY = 3.0, 2.0
"""Standard errors by which a clearly better prediction is better, and one that is likely."""
_BETTER = 0.75
"""Fraction of what another prediction misses that a clearly better one misses at most."""
_SAMPLES = 1_000_000
COARSEN_FROM = 100_000
"""Sensor pixels from which on 2×2 of them are one while a weight is chosen."""


class Predicting(Protocol):
    """What is asked of a problem, of one scene or a stack, whose weight is to be chosen."""

    @property
    def data(self) -> Tensor:
        """(channels, rows, columns)."""

    @property
    def valid(self) -> Tensor:
        """Like the data."""

    @property
    def scene_shape(self) -> tuple[int, ...]:
        """Of a scene, channels first."""

    @property
    def tau_unit(self) -> float:
        """See `Problem.tau_unit`."""

    @property
    def channel_weights(self) -> Tensor:
        """See `Problem.channel_weights`."""

    def residual(self, scene: Tensor) -> Tensor:
        """See `Problem.residual`."""


@dataclass(frozen=True)
class Prediction:
    """How well a scene predicts pixels that were left out of its fit.

    All are root mean squares over the held-out pixels, without local means, in normalised units.

    Parameters
    ----------
    residual
        Of what it misses.
    contrast
        Of the measurement itself.
    noise
        Of the measurement's pixels.
    """

    residual: float
    contrast: float
    noise: float
    blocks: Tensor = field(default_factory=lambda: torch.empty(0), repr=False, compare=False)
    """Squared residual of each block that was left out, over the squared contrast of all; none
    of a fit (`fit`)."""
    dark_blocks: Tensor = field(default_factory=lambda: torch.empty(0), repr=False, compare=False)
    """The same where nothing is predicted: each block's squared contrast."""

    @property
    def unexplained(self) -> float:
        """Fraction of the contrast's power that it misses, from 0 to about 1."""
        return (self.residual / self.contrast) ** 2

    @property
    def unexplained_by_noise(self) -> float:
        """What a perfect scene would miss."""
        return (self.noise / self.contrast) ** 2

    @property
    def missed(self) -> float:
        """Fraction of what is not noise that it misses, from 0 to about 1."""
        noise = self.unexplained_by_noise
        return max(self.unexplained - noise, 0.0) / max(1 - noise, 1e-6)

    def excess(self, other: "Prediction") -> tuple[float, float]:
        """How much more is unexplained than by another of the same blocks; its standard error."""
        return excess_of(self.blocks, other.blocks)

    def is_likely_better(self, other: "Prediction") -> bool:
        """Whether it explains the same blocks better, by two standard errors."""
        return are_likely_less(self.blocks, other.blocks)

    def is_clearly_better(self, other: "Prediction") -> bool:
        """Whether it explains the same blocks better, beyond doubt and by more than a little."""
        excess, error = other.excess(self)
        return excess > _SURE * error and self.missed < _BETTER * other.missed

    def explains_less(self, fraction: float) -> bool:
        """Whether it explains less than a fraction of what is not noise, by two standard errors."""
        noise = self.unexplained_by_noise
        rest = noise + (1 - fraction) * (1 - noise)
        excess, error = excess_of(self.blocks, rest * self.dark_blocks)
        return excess > _LIKELY * error

    @property
    def explains_anything(self) -> bool:
        """Whether it predicts its blocks better than no scene does, by two standard errors."""
        return are_likely_less(self.blocks, self.dark_blocks)

    @property
    def explained(self) -> float:
        """Fraction of what is not noise that it explains: 1 for a perfect scene, 0 for none."""
        return 1 - self.missed


@dataclass(frozen=True)
class WeightStep:
    """A weight that was tried.

    Parameters
    ----------
    tau
        As users give it (`Problem.weight`).
    residual
        Root mean square, over the held-out pixels, of what the scene does not predict, over the
        noise that was measured.
    error
        Standard error of the mean squared residual's difference from the best, over the best.
    excess
        That difference, over the best.
    """

    tau: float
    residual: float
    excess: float
    error: float

    def row(self) -> dict[str, float]:
        """A row of the run's record."""
        return {
            "tau": self.tau,
            "held_out_residual": self.residual,
            "excess": self.excess,
            "standard_error": self.error,
        }


@dataclass(frozen=True)
class Weight:
    """A weight of the prior, and what it was chosen by.

    Parameters
    ----------
    tau
        As users give it (`Problem.weight`).
    noise
        Standard deviation of a pixel's noise in normalised units, of all channels together.
    steps
        Weights that were tried, from strong to weak; none where the noise alone decided.
    prediction
        That of the best of them; None without any.
    interrupted
        Whether the caller stopped it.
    """

    tau: float
    noise: float
    steps: tuple[WeightStep, ...] = ()
    prediction: Prediction | None = None
    interrupted: bool = False


def choose_weight(
    problem: Problem,
    *,
    penalties: Penalties | None = None,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float | None = None,
    progress: Callable[[float], bool | None] | None = None,
) -> Weight:
    """The weight of the prior with which left-out pixels are predicted best.

    The first weight is the one that the noise asks for. From there they go down by factors of 2
    until the prediction is worse, and from the best of them up until it is worse again; every
    scene starts from the one before it. It takes about as long as one reconstruction.

    Parameters
    ----------
    problem
        Whose prior is to be weighed; its own weight does not matter.
    penalties, balance, relaxation
        As `admm` takes them.
    progress
        Called with the fraction that is done; stops by returning True.
    """
    noise = pixel_noise(problem)
    if problem.prior is Prior.NONE:
        return Weight(0.0, noise)
    blocks = held_out_blocks(problem.valid)
    by_noise = weight_by_noise(problem)
    if blocks is None:
        return by_noise
    path = _Path(problem, blocks, penalties, balance, relaxation, progress)
    interrupted = path.follow(_FROM[problem.prior] * noise)
    if not path.errors:
        return replace(by_noise, interrupted=interrupted)
    return replace(
        weight_of_errors(problem, path.errors, noise, path.held, blocks), interrupted=interrupted
    )


def weight_by_noise(problem: Problem) -> Weight:
    """The weight that the noise asks for, at once; `choose_weight` knows better (decision 13).

    Parameters
    ----------
    problem
        Whose prior is to be weighed; its own weight does not matter.
    """
    noise = pixel_noise(problem)
    return Weight(_BY_NOISE.get(problem.prior, 0.0) * noise / problem.tau_unit, noise)


@dataclass(frozen=True)
class PartialFit:
    """A fit of a problem without the held-out pixels.

    Parameters
    ----------
    scene
        In normalised units.
    fitted
        bool, like the data: pixels that took part.
    prediction
        Of the others.
    """

    scene: Tensor
    fitted: Tensor
    prediction: Prediction


def fit_partially(problem: Problem, steps: int = _FIRST_STEPS) -> PartialFit | None:
    """So many iterations of ADMM without the held-out pixels, with the noise's own weight.

    None where the problem has too few pixels.

    Parameters
    ----------
    problem
        With a prior; its weight does not matter.
    steps
        Iterations.
    """
    blocks = held_out_blocks(problem.valid)
    if blocks is None:
        return None
    noise = pixel_noise(problem)
    path = _Path(problem, blocks, None, Balance(), None, None)
    errors = path.first(_FROM[problem.prior] * noise, steps)
    prediction = _prediction(problem, errors, noise, path.held, blocks)
    return PartialFit(path.scene(), problem.valid & ~path.held, prediction)


def predict(problem: Problem) -> Prediction | None:
    """How well pixels that are left out of the fit are predicted, with the noise's own weight.

    A few tens of iterations of ADMM on the problem as it is: make it coarse
    (`Reconstructor.coarse_problem`). None where it has too few pixels.

    Parameters
    ----------
    problem
        As `fit_partially` takes it.
    """
    fitted = fit_partially(problem)
    return None if fitted is None else fitted.prediction


def fit(problem: Problem, scene: Tensor) -> Prediction:
    """How well a scene explains the pixels that it was fitted to, in the terms of `Prediction`.

    Parameters
    ----------
    problem
        That was solved.
    scene
        In units of measurement over PSF.
    """
    fitted, weights = problem.valid, problem.channel_weights

    def size(residual: Tensor) -> float:
        rest = torch.where(fitted, residual - local_mean(residual, fitted), 0)
        squares = rest.square().sum((-2, -1), dtype=torch.float64).cpu()
        counts = fitted.sum((-2, -1)).cpu().clamp_min(1)
        return math.sqrt(float(weights @ (squares / counts)))

    residual = problem.residual(scene / problem.scale)
    return Prediction(size(residual), size(problem.data), pixel_noise(problem))


def pixel_noise(problem: Predicting) -> float:
    """Standard deviation of a pixel's white noise in normalised units, of all channels together.

    Mixed second differences know no shading, and little of a PSF's detail: half the median of
    their magnitudes over 0.6745 (`donoho1994`).

    Parameters
    ----------
    problem
        Whose data are measured.
    """
    noise = [_noise(*each) for each in zip(problem.data, problem.valid, strict=True)]
    weights = problem.channel_weights
    total = float(weights @ torch.tensor(noise, dtype=weights.dtype).square())
    return max(math.sqrt(total), _least_noise(problem))


def channel_noise(problem: Problem) -> Tensor:
    """`pixel_noise` of each channel, (channels,)."""
    noise = [_noise(*each) for each in zip(problem.data, problem.valid, strict=True)]
    return problem.data.new_tensor(noise).clamp_min(_least_noise(problem))


def _least_noise(problem: Predicting) -> float:
    # A measurement of root mean square r has the norm r √N = 1.
    return _QUIETEST / math.sqrt(problem.data[0].numel())


def _noise(data: Tensor, valid: Tensor) -> float:
    mixed = data[:-1, :-1] - data[1:, :-1] - data[:-1, 1:] + data[1:, 1:]
    if bool(valid.all()):
        usable = mixed.flatten()
    else:
        usable = mixed[valid[:-1, :-1] & valid[1:, :-1] & valid[:-1, 1:] & valid[1:, 1:]]
    sizes = usable[:: max(1, usable.numel() // _SAMPLES)].abs()
    if not sizes.numel():
        return 0.0
    # Half of what the mean says is a floor: values of a few levels can have a median of zero.
    return max(float(sizes.median()) / 0.6745, float(sizes.mean()) * math.sqrt(math.pi / 8)) / 2


def held_out_blocks(valid: Tensor) -> Tensor | None:
    """Blocks to leave out, bool (rows, columns) of blocks; None where they are too few."""
    rows, columns = (count // _SIDE for count in valid.shape[-2:])
    generator = torch.Generator().manual_seed(0)
    if min(rows, columns) == 0:
        return None
    fraction = min(max(_FRACTION, _BLOCKS / (rows * columns)), _FRACTION_AT_MOST)
    chosen = torch.rand(rows, columns, generator=generator) < fraction
    whole = valid[:, : rows * _SIDE, : columns * _SIDE].all(0)
    usable = whole.view(rows, _SIDE, columns, _SIDE).all(-1).all(1).cpu()
    chosen &= usable
    return chosen if int(chosen.sum()) >= _FEWEST_BLOCKS else None


def search_weight(
    first: float, errors: Callable[[float, float], Tensor | None]
) -> tuple[dict[float, Tensor], bool]:
    """Weights down from the first until the prediction is worse, and from the best of them up.

    Parameters
    ----------
    first
        In normalised units.
    errors
        From a weight, and the fraction that is done, to the squared errors of the blocks; None
        ends the search.

    Returns
    -------
    tuple
        The errors by weight, and whether the search was ended.
    """
    tried: dict[float, Tensor] = {}

    def try_weight(tau: float) -> bool:
        found = errors(tau, min((1 + len(tried)) / (2 + _WEIGHTS_AT_MOST), 1.0))
        if found is not None:
            tried[tau] = found
        return found is not None

    def best() -> float:
        return min(tried, key=lambda each: float(tried[each].sum()))

    if not try_weight(first):
        return tried, True
    for factor in (1 / _RATIO, _RATIO):
        # On the way back what was slow to converge has had its time: it counts anew.
        tau = best()
        for _ in range(_WEIGHTS_AT_MOST):
            tau *= factor
            if not try_weight(tau):
                return tried, True
            excess, error = excess_of(tried[tau], tried[best()])
            if tau != best() and excess > error:
                break
    return tried, False


class _Path:
    """Weights down and up again, each solved from where the one before ended."""

    def __init__(
        self,
        problem: Problem,
        blocks: Tensor,
        penalties: Penalties | None,
        balance: Balance | None,
        relaxation: float | None,
        progress: Callable[[float], bool | None] | None,
    ) -> None:
        self._problem, self._blocks = problem, blocks
        self.held, self._fitted = without_blocks(problem, blocks)
        # A weight of zero would leave out the split.
        self._state = AdmmState.cold(replace(self._fitted, tau=1.0), penalties)
        self._balance, self._relaxation = balance, relaxation
        self._progress, self._done = progress, 0
        self.errors: dict[float, Tensor] = {}
        """Squared errors of the blocks, by weight."""

    def first(self, tau: float, steps: int = _FIRST_STEPS) -> Tensor:
        """Squared errors of the blocks with one weight."""
        self._solve(tau, steps)
        self._note(tau)
        return self.errors[tau]

    def follow(self, first: float) -> bool:
        """Try weights until the best one is known; True where the caller stopped it."""

        def errors(tau: float, _: float) -> Tensor | None:
            if self.errors:
                self._loosen()
                stopped = self._solve(tau, _STEPS)
            else:
                stopped = self._solve(tau, _FIRST_STEPS - _STEPS, settle=True)
            if stopped:
                return None
            self._note(tau)
            return self.errors[tau]

        return search_weight(first, errors)[1]

    def _loosen(self) -> None:
        state = self._state
        first, second, third = (_LOOSENED * mu for mu in state.penalties)
        state.renew(self._fitted, (first, second, third))

    def _solve(self, tau: float, steps: int, *, settle: bool = False) -> bool:
        """Go on to so many iterations with a weight; True where the caller stopped it.

        With `settle`, go on from there until the prediction gets hardly better.
        """
        state = self._state
        weighted = replace(self._fitted, tau=tau)
        state.weigh(weighted)
        run = start_run(weighted, state, balance=self._balance, relaxation=self._relaxation)
        stopped, last = False, math.inf
        while state.iteration < steps and not stopped:
            run.to_check(steps)
            self._done += 1
            most = _FIRST_STEPS + _WEIGHTS_AT_MOST * _STEPS
            fraction = min(CHECK_EVERY * self._done / most, 1.0)
            stopped = self._progress is not None and bool(self._progress(fraction))
            if settle and state.iteration == steps < _FIRST_AT_MOST:
                error = float(self._predicted().mean())
                if last > (1 + _SETTLED) * error:
                    last, steps = error, steps + _STEPS
        run.end()
        return stopped

    def _note(self, tau: float) -> None:
        self.errors[tau] = self._predicted()

    def _predicted(self) -> Tensor:
        """Squared errors of the blocks by the scene so far."""
        return prediction_errors(self._problem, self.scene(), self.held, self._blocks)

    def scene(self) -> Tensor:
        """The scene so far, in normalised units."""
        return self._state.scene()


def without_blocks(problem: Problem, blocks: Tensor) -> tuple[Tensor, Problem]:
    """Pixels of blocks, (height, width), and the problem without them."""
    held = pixels_of(blocks, problem.forward.sensor).to(problem.data.device)
    data = torch.where(held, 0, problem.data)
    return held, replace(problem, data=data, valid=problem.valid & ~held)


def pixels_of(blocks: Tensor, sensor: tuple[int, int]) -> Tensor:
    """Sensor pixels of blocks, bool (height, width)."""
    held = torch.zeros(sensor, dtype=torch.bool)
    rows, columns = (count * _SIDE for count in blocks.shape)
    held[:rows, :columns] = blocks.repeat_interleave(_SIDE, 0).repeat_interleave(_SIDE, 1)
    return held


def prediction_errors(problem: Predicting, scene: Tensor, held: Tensor, blocks: Tensor) -> Tensor:
    """Mean squared error of what a normalised scene predicts of each held-out block; float64."""
    residual = problem.residual(scene)
    residual -= local_mean(residual, problem.valid & ~held)
    rows, columns = blocks.shape
    squares = residual[:, : rows * _SIDE, : columns * _SIDE].square()
    by_block = nnf.avg_pool2d(squares[None], _SIDE)[0].double().cpu()[:, blocks]
    return problem.channel_weights @ by_block


def local_mean(residual: Tensor, fitted: Tensor) -> Tensor:
    """Mean of a residual over the fitted pixels around each pixel."""
    side = 2 * _AROUND + 1
    weight = fitted.to(residual.dtype)
    return box_mean(residual * weight, side) / box_mean(weight, side).clamp_min(1e-3)


def box_mean(planes: Tensor, side: int) -> Tensor:
    """Means over side×side pixels around each, zeros beyond the edges.

    By sums of 1, 2, 4, … neighbours, a dozen additions at most: `avg_pool2d` adds each of the
    side's pixels, one after the other.

    Parameters
    ----------
    planes
        (channels, height, width).
    side
        Odd.
    """
    return _sums_along(_sums_along(planes, side, -2), side, -1).mul_(1 / side**2)


def _sums_along(planes: Tensor, side: int, axis: int) -> Tensor:
    """Sums over so many pixels around each, along one axis."""
    around = side // 2
    edges = (0, 0, around, around) if axis == -2 else (around, around)
    sums, length = nnf.pad(planes, edges), 1
    total, first = torch.zeros_like(planes), 0
    while True:
        if side & length:
            total += sums.narrow(axis, first, planes.shape[axis])
            first += length
        if 2 * length > side:
            return total
        count = sums.shape[axis] - length
        sums = sums.narrow(axis, 0, count) + sums.narrow(axis, length, count)
        length *= 2


def are_likely_less(errors: Tensor, others: Tensor) -> bool:
    """Whether errors of blocks are less than others of the same blocks, by two standard errors."""
    excess, error = excess_of(others, errors)
    return excess > _LIKELY * error


def excess_of(errors: Tensor, best: Tensor) -> tuple[float, float]:
    """Mean difference of the blocks' squared errors from others', and its standard error."""
    apart = errors - best
    return float(apart.mean()), float(apart.std()) / math.sqrt(len(apart))


def weight_of_errors(
    problem: Predicting, errors: dict[float, Tensor], noise: float, held: Tensor, blocks: Tensor
) -> Weight:
    """The choice, from the squared errors of the blocks by `Problem.tau`."""
    steps = _steps(errors, noise, problem.tau_unit)
    best = min(errors.values(), key=lambda each: float(each.sum()))
    return Weight(_strongest(steps), noise, steps, _prediction(problem, best, noise, held, blocks))


def _prediction(
    problem: Predicting, errors: Tensor, noise: float, held: Tensor, blocks: Tensor
) -> Prediction:
    dark = problem.data.new_zeros(problem.scene_shape)
    powers = prediction_errors(problem, dark, held, blocks)
    contrast = float(powers.mean())
    residual = math.sqrt(float(errors.mean()))
    return Prediction(residual, math.sqrt(contrast), noise, errors / contrast, powers / contrast)


def _steps(errors: dict[float, Tensor], noise: float, unit: float) -> tuple[WeightStep, ...]:
    """Weights from strong to weak, from the squared errors of the blocks by `Problem.tau`."""
    best = min(errors.values(), key=lambda each: float(each.sum()))
    least = float(best.mean())
    steps = []
    for tau in sorted(errors, reverse=True):
        excess, error = excess_of(errors[tau], best)
        residual = math.sqrt(float(errors[tau].mean())) / noise
        steps.append(WeightStep(tau / unit, residual, excess / least, error / least))
    return tuple(steps)


def _strongest(steps: tuple[WeightStep, ...]) -> float:
    """Strongest weight whose error is the best's but for one standard error, between the steps."""
    place = min(range(len(steps)), key=lambda at: steps[at].excess)
    while place > 0 and steps[place - 1].excess <= steps[place - 1].error:
        place -= 1
    if place == 0:
        return steps[0].tau
    within, beyond = steps[place], steps[place - 1]
    room, rise = beyond.error - within.excess, beyond.excess - within.excess
    # The error is a parabola around the best.
    part = math.sqrt(max(room, 0.0) / rise) if rise > 0 else 0.0
    return within.tau * math.pow(beyond.tau / within.tau, min(part, 1.0))
