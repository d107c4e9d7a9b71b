"""Plug-and-play: a trained network in turn with the fit of the measurement."""

import math
from collections.abc import Callable, Generator, Iterable, Iterator
from copy import deepcopy
from dataclasses import dataclass, field, replace
from itertools import islice

import torch
from torch import Tensor

from nolens.operators import Geometry
from nolens.solvers.admm_state import Penalties
from nolens.solvers.coarse import Coarse, Errors
from nolens.solvers.denoising_network import BANDS, DenoisingNetwork, denoise
from nolens.solvers.linear_step import LinearStep
from nolens.solvers.problem import Problem
from nolens.solvers.result import Callback, Progress, Result, follow

_STRENGTH = 0.7
"""Of turns on larger pixels."""
_WIDEST, _FALL = 30.0, 0.8
"""Spread of the first turn, in whites, and by what wide ones fall to the prior's own: slow parts of
a scene, which many PSFs hardly carry, move by much there alone (decision 24)."""
_KEPT = 0.15
"""How much of the photograph stays in the picture after wide spreads: it has too little slow light
of its own, and they bring in too much (decision 24)."""
MANY_PIXELS = 5_000_000
"""`Problem.padded_pixels` beyond which turns may take minutes."""
FEW_TURNS_PIXELS = 8_000_000
"""Those beyond which only every second turn is taken, on larger pixels and on the problem's own
(decision 26)."""
MINUTES_PIXELS = 25_000_000
"""Those beyond which turns take minutes, with twenty for each pixel of the scene, which the network
goes over."""
_FINEST = 0.6
"""Of the noise in the band of a fit that has most, that in the finest at least, where the
measurement carries the finest detail: 1 is the strength of Bayes' rule there."""
_MOST, _HALF, _RISE = 2 / 3, 0.5, 1 / 6
"""The strength where there is less, at most, and as it follows from how much: (finest /
half)^rise (decision 24)."""
_ERROR = 0.55
"""Of the model, over the noise, from which on a weaker prior would let it in: the strength stays
the most. The photograph then leaves 1.03 times the noise."""
REFINED_PICTURES = 3
"""That a `Refinement`'s network takes."""
_WHITE = 0.995
"""Fraction of the photograph's values below its white."""
_NEAR = 1.0
"""How far a picture may be from the scene whose fit tells its own noise."""
_FROM_NOISE, _OF_NOISE, _NARROWEST = 5.0, 0.4, 0.1
"""Where the measurement carries the finest detail, spreads fall from the first times that noise to
the second: they end before the prior's own do, or go on below those, to the last times their last
at most (decision 24)."""
_BYTES_PER_PIXEL = 120
"""Held in the fit, per pixel of the padded shape."""


def plug_and_play_bytes(pixels: float, network: DenoisingNetwork) -> float:
    """Most memory that a run holds at once, for so many `Problem.padded_pixels`."""
    return pixels * _BYTES_PER_PIXEL + network.tile_bytes


def takes_few_turns(problem: Problem) -> bool:
    """Whether a problem has more than `FEW_TURNS_PIXELS`."""
    return problem.padded_pixels > FEW_TURNS_PIXELS


def takes_minutes(channels: int, geometry: Geometry) -> bool:
    """Whether turns of a network take minutes.

    Parameters
    ----------
    channels, geometry
        Of the problem.
    """
    padded, scene = channels * math.prod(geometry.padded), math.prod(geometry.scene[2:])
    return padded > MANY_PIXELS and padded + 20 * scene > MINUTES_PIXELS


class Fit:
    r"""The scene that fits a measurement, near a picture z; all in units of the photograph's white.

    .. math:: x = \arg\min_v \tfrac12 ‖(b − Av)/σ‖^2 + \tfrac{1}{2 s^2} ‖v − z‖^2

    A few steps of conjugate gradients go on from the fit before (`LinearStep`). σ² is that of a
    channel's noise, and of the model's error, which counts as noise (`Errors`). The noise of the
    measurement in x is that of the circulant mean.

    Parameters
    ----------
    problem
        In normalised units; its prior and weight do not matter.
    photograph
        To start from, in units of measurement over PSF.
    errors
        Of the measurement; None tells them from the photograph.
    """

    def __init__(
        self,
        problem: Problem,
        photograph: Tensor,
        errors: Errors | None = None,
    ) -> None:
        scene = photograph / problem.scale
        errors = Errors.of(problem, photograph) if errors is None else errors
        self.noise = errors.whole
        self.errs = bool((errors.model > _ERROR * errors.noise).any())
        self.scale = problem.scale.flatten()
        values = photograph.flatten()
        white = float(torch.quantile(values[:: 1 + values.numel() // 10**6], _WHITE))
        self.white = white if 0 < white < math.inf else 1.0
        self.steps = [
            LinearStep(problem.single(each), scene[each : each + 1], varied=False)
            for each in range(problem.channels)
        ]

    def measure(self, problem: Problem) -> None:
        """Go on with other valid pixels, or another measurement."""
        scale = problem.scale.flatten()
        if not torch.equal(scale, self.scale):
            factors = self.scale / scale
            self.noise, self.scale = self.noise * factors, scale
            scenes = [each * factor for each, factor in zip(self.scenes, factors, strict=True)]
            self.resume(scenes)
        for number, step in enumerate(self.steps):
            step.measure(problem.single(number))

    @property
    def scenes(self) -> list[Tensor]:
        """X of every channel, normalised; `resume` goes on from it."""
        return [step.v for step in self.steps]

    def resume(self, scenes: list[Tensor]) -> None:
        """Go on from `scenes`."""
        for step, each in zip(self.steps, scenes, strict=True):
            step.v = each

    def restart(self, picture: Tensor) -> None:
        """Go on from a picture in units of the white."""
        for number, step in enumerate(self.steps):
            step.v = self.white / self.scale[number] * picture[number : number + 1]

    def penalties(self, channel: int, spread: float) -> Penalties:
        """What the linear step weighs the picture with."""
        unit = self.white / self.scale[channel]  # normalised values of a white
        return 0.0, 0.0, float((self.noise[channel] / (spread * unit)) ** 2)

    def finest(self, spread: float) -> float:
        """How much of the finest detail of a scene near a picture the measurement carries.

        It is x's noise in the finest band over that in the band with most, of the channel with
        least: where the measurement does not carry it, x has the picture's detail, and no noise.
        """
        gains = [
            step.noise_gain(self.penalties(number, spread), BANDS)
            for number, step in enumerate(self.steps)
        ]
        return _finest(torch.stack(gains))

    def strength(self, spread: float) -> float:
        """The q of turns.

        Parameters
        ----------
        spread
            The last, where the fit has least of the picture.
        """
        finest = self.finest(spread)
        if finest >= _FINEST:
            return 1.0
        return _MOST if self.errs else min((finest / _HALF) ** _RISE, _MOST)

    def learn_noise(self, problem: Problem, scene: Tensor) -> None:
        """Take what a picture leaves for the noise of channels where that is less (`Errors`).

        Parameters
        ----------
        problem
            That the fit is of.
        scene
            The picture, in units of measurement over PSF.
        """
        errors = Errors.of(problem, scene)
        self.noise = torch.where(errors.model > 0, self.noise, self.noise.minimum(errors.noise))

    def own_noise(self, last: float, near: float) -> float:
        """The noise in a fit near a picture, of the channel with most, over all bands.

        A picture that the network has smoothed by much more is worse than the fit. Infinite where
        the measurement does not carry the finest detail, and the fit has the picture's.

        Parameters
        ----------
        last
            Spread of the last turn.
        near
            How far the picture may be from the scene.
        """
        if self.finest(last) < _FINEST:
            return math.inf
        return float(self.noise_near(near).square().mean(dim=1).sqrt().max())

    def noise_near(self, spread: float) -> Tensor:
        """The noise in a fit of each channel and band, (channels, `BANDS`), in units of the white.

        Parameters
        ----------
        spread
            How far the picture that it is near may be from the scene.
        """
        unit = self.white / self.scale
        return torch.stack(
            [
                noise / white * step.noise_gain(self.penalties(number, spread), BANDS)
                for number, (step, noise, white) in enumerate(
                    zip(self.steps, self.noise, unit, strict=True)
                )
            ]
        )

    def near(self, picture: Tensor, spread: float) -> tuple[Tensor, Tensor]:
        """X, and the noise in it of each channel and band, (channels, `BANDS`).

        Parameters
        ----------
        picture
            z, (channels, height, width).
        spread
            s: how far z may be from the scene.
        """
        fitted = []
        for number, step in enumerate(self.steps):
            unit, penalties = self.white / self.scale[number], self.penalties(number, spread)
            step.solve(penalties[2] * unit * picture[number : number + 1], penalties)
            fitted.append(step.v / unit)
        return torch.cat(fitted), self.noise_near(spread)


@dataclass(frozen=True)
class Turn:
    """One turn of fit and network, in units of the white.

    Parameters
    ----------
    number
        Counted from 0.
    fit
        x, (channels, height, width).
    picture
        z: what the network makes of it, and not below zero.
    multiplier
        d: what it has taken off so far.
    noise
        In the fit, of each channel and band, (channels, `BANDS`).
    spread
        s: that of the network.
    white
        In units of measurement over PSF.
    strength
        q.
    """

    number: int
    fit: Tensor
    picture: Tensor
    multiplier: Tensor
    noise: Tensor
    spread: float
    white: float
    strength: float

    @property
    def scene(self) -> Tensor:
        """The picture in units of measurement over PSF."""
        return self.picture * self.white

    @property
    def finest(self) -> float:
        """How much of the finest detail the measurement carries, as `Fit.finest`."""
        return _finest(self.noise)

    @property
    def pictures(self) -> Tensor:
        """What a `Refinement` sees: z, x + d and x, (3, channels, height, width)."""
        return torch.stack([self.picture, self.picture + self.multiplier, self.fit])


def _finest(noise: Tensor) -> float:
    """Of (channels, bands): the finest band over that with most, of the channel with least."""
    return float((noise[:, -1] / noise.amax(dim=1)).min())


@dataclass(frozen=True)
class Refinement:
    """A network that mends the picture of the last turn.

    It was trained on what turns leave of measurements by many cameras, which are not quite as their
    model: noise that has a colour, traces of a PSF that errs, detail that is not there. It gets the
    picture, what the last network took it from and the fit, and is told the noise in the fit. Its
    errors differ where all is upside down, so it makes both, and their mean counts.

    Parameters
    ----------
    network
        Of `REFINED_PICTURES`.
    share
        Of what the network changes, how much counts. One that learnt on other cameras than that of
        the picture changes too much (decision 24).
    finest
        A picture whose measurement carries more of the finest detail (`Turn.finest`) stays.
    """

    network: DenoisingNetwork
    share: float = 1.0
    finest: float = 1.0

    def __call__(self, turn: Turn) -> Tensor:
        """The picture without what is not of the scene, in units of the white."""
        if turn.finest > self.finest:
            return turn.picture
        network = on_device(turn.picture.device, self.network)
        both = [denoise(network, turn.pictures, turn.noise, turn.spread, each) for each in (0, 2)]
        mended = torch.stack(both).mean(dim=0).clamp_min(0)
        return torch.lerp(turn.picture, mended, self.share)


@dataclass(frozen=True)
class PlugAndPlay:
    r"""A prior that is a network; it takes turns with the fit (`venkatakrishnan2013`).

    .. math:: x_k = \arg\min_v \tfrac12 ‖(b − Av)/σ‖^2
       + \tfrac{q^2}{2 s_k^2} ‖v − z_{k-1} + d_{k-1}‖^2, \quad z_k = D(x_k + d_{k-1}; s_k)_+,
       \quad d_k = x_k + d_{k-1} − z_k

    Where a network that takes out white noise of the deviation s is the proximal map of s² R for
    some R, q² is the weight of R beside the measurement, whatever s is: 1 is that of Bayes' rule.
    Where the measurement carries the finest detail, noise in the fit is about white, as the network
    takes it, and q is 1. Elsewhere q follows from how much of it is carried (`Fit.finest`).

    Turns start from a photograph by total variation, whose white is the unit of all. The first ones
    have wider spreads, and are on larger pixels where there are many: they correct the slow parts
    of the photograph (`turns_from_wide`). There is no objective, so the number of turns follows
    from the spreads: where the measurement carries the finest detail, these fall to a part of the
    fit's own noise (`Fit.own_noise`), be it more or less than the last of them. A `Refinement` may
    come after the turns.

    Parameters
    ----------
    network
        D.
    spreads
        s of each turn, in units of the white; wider ones come before, and more may follow.
    facts
        What a record says of it: the prior, and the hash of its weights.
    detail
        What the prior's weight, q² of the strength that follows from the measurement, is divided
        by: 2 shows more detail and more noise.
    refinement
        Makes the last picture of the last turn's; None leaves that.
    """

    network: DenoisingNetwork = field(repr=False)
    spreads: tuple[float, ...]
    facts: dict[str, str] = field(default_factory=dict)
    detail: float = 1.0
    refinement: Callable[[Turn], Tensor] | None = field(default=None, repr=False)

    def from_wide(self, widest: float) -> "PlugAndPlay":
        """The prior with wider spreads before its own.

        Parameters
        ----------
        widest
            s of the first turn at most.
        """
        wide = [self.spreads[0]]
        while wide[-1] / _FALL <= widest:
            wide.append(wide[-1] / _FALL)
        return replace(self, spreads=(*wide[:0:-1], *self.spreads))

    def turns(
        self,
        problem: Problem,
        photograph: Tensor,
        strength: float = 1.0,
        fit: Fit | None = None,
        after: Turn | None = None,
    ) -> Iterator[Turn]:
        """All turns, one after the other.

        Parameters
        ----------
        problem
            In normalised units.
        photograph
            To start from, in units of measurement over PSF.
        strength
            q.
        fit
            Of the problem, where there is one already.
        after
            The turn before the first, of a fit that stands there; None begins with the photograph.
        """
        fit = Fit(problem, photograph) if fit is None else fit
        if after is None:
            picture = photograph / fit.white
            fit.restart(picture)
            multiplier, first = torch.zeros_like(picture), 0
        else:
            picture, multiplier, first = after.picture, after.multiplier, after.number + 1
        network = on_device(problem.data.device, self.network)
        for number, spread in enumerate(self.spreads[first:], first):
            # The multiplier d / s² stays where the spread changes.
            multiplier = multiplier * (spread / self.spreads[max(number - 1, 0)]) ** 2
            x, noise = fit.near(picture - multiplier, spread / strength)
            noisy = x + multiplier
            picture = denoise(network, noisy, torch.full_like(noise, spread), turn=number)
            picture = picture.clamp_min(0)
            multiplier = noisy - picture
            yield Turn(number, x, picture, multiplier, noise, spread, fit.white, strength)

    def turns_from_wide(
        self,
        own: int,
        problem: Problem,
        photograph: Tensor,
        strength: float = 1.0,
        fit: Fit | None = None,
    ) -> Iterator[Turn]:
        """All turns; after the wide ones some of the photograph comes back into the picture.

        Parameters
        ----------
        own
            How many of the spreads, the last ones, are not wide.
        problem, photograph, strength, fit
            As `turns` takes them.
        """
        fit = Fit(problem, photograph) if fit is None else fit
        turns, after = self.turns(problem, photograph, strength, fit), None
        if own < len(self.spreads):
            for after in islice(turns, len(self.spreads) - own + 1):
                yield after
            assert after is not None
            picture = after.picture.lerp(photograph / fit.white, _KEPT)
            fit.restart(picture)
            multiplier = (1 - _KEPT) * after.multiplier
            after = replace(after, picture=picture, multiplier=multiplier)
            turns = self.turns(problem, photograph, strength, fit, after)
        yield from turns

    @torch.no_grad()
    def solve(
        self,
        problem: Problem,
        first: Result,
        callback: Callback | None = None,
        coarse: Coarse | None = None,
    ) -> Result:
        """The scene of a problem.

        Parameters
        ----------
        problem
            In normalised units; its prior and weight do not matter.
        first
            A photograph to start from, by total variation.
        callback
            Sees each turn, and stops the run by returning True.
        coarse
            The problem on larger pixels, where the first photograph is of that: turns on those
            come before turns on the problem's own.

        Raises
        ------
        DivergenceError
            If a picture is NaN or infinite.
        """
        scene, pixels, done = first.scene, problem, first.iterations
        weaker = math.sqrt(self.detail)
        step = 2 if coarse is not None and takes_few_turns(problem) else 1

        def taken(prior: PlugAndPlay) -> PlugAndPlay:
            """With the turns that this many pixels leave time for; the last is among them."""
            return replace(prior, spreads=prior.spreads[::-step][::-1])

        def latest() -> Tensor:
            """On the problem's pixels, normalised."""
            if coarse is None or pixels.forward is problem.forward:
                return scene / problem.scale
            return coarse.finer(scene, problem) / problem.scale

        def run(
            of: Problem, start: Tensor, turns: Iterable[Turn], end: int
        ) -> Generator[Progress, None, Turn | None]:
            """The last turn; the run is expected to end with that of a number."""
            nonlocal scene, pixels, done
            scene, pixels, turn = start, of, None
            for turn in turns:
                before, scene, done = scene, turn.scene, done + 1
                change = _relative(scene - before, scene)
                yield Progress(
                    iteration=done,
                    objective=of.objective(scene / of.scale),
                    primal_residual=_relative(turn.fit - turn.picture, turn.picture),
                    dual_residual=change,
                    scene_change=change,
                    penalties=(turn.strength,),
                    scene=latest,
                    expected=done + end - turn.number,
                )
            return turn

        def checks() -> Iterator[Progress]:
            photograph, errors, prior = first.scene, None, taken(self)
            own = len(prior.spreads)
            if coarse is not None:
                before = taken(self.from_wide(_WIDEST))
                turns = before.turns_from_wide(own, coarse.problem, photograph, _STRENGTH / weaker)
                end = len(before.spreads) + own - 1
                yield from run(coarse.problem, photograph, turns, end)
                errors = coarse.errors(photograph, problem)
                photograph = latest() * problem.scale
            fit = Fit(problem, photograph, errors)
            noise = fit.own_noise(self.spreads[-1], _NEAR)
            if math.isfinite(noise):
                spreads = taken(self.from_wide(_FROM_NOISE * noise)).spreads
                wide = tuple(each for each in spreads if each >= _OF_NOISE * noise)
                prior = replace(self, spreads=wide or spreads[:1])
                own = len(prior.spreads)
            elif coarse is None:
                prior = self.from_wide(_WIDEST)
            strength = fit.strength(self.spreads[-1]) / weaker
            turns = prior.turns_from_wide(own, problem, photograph, strength, fit)
            last = yield from run(problem, photograph, turns, len(prior.spreads) - 1)
            lowest = _NARROWEST * self.spreads[-1]
            while last is not None and prior.spreads[-1] > lowest:
                fit.learn_noise(problem, last.scene)
                noise = fit.own_noise(self.spreads[-1], _NEAR)
                if prior.spreads[-1] <= _OF_NOISE * noise:
                    break
                prior = replace(prior, spreads=(*prior.spreads, _FALL * prior.spreads[-1]))
                turns = prior.turns(problem, photograph, strength, fit, last)
                last = yield from run(problem, last.scene, turns, last.number + 1)
            if self.refinement is not None and last is not None:
                refined = replace(last, picture=self.refinement(last))
                yield from run(problem, last.scene, [refined], last.number)

        rows, reason = follow(checks(), lambda _: False, callback)
        normalised = latest()
        started = first.scene if coarse is None else coarse.finer(first.scene, problem)
        return Result(
            scene=problem.unscale(normalised),
            objective=problem.objective(normalised),
            iterations=first.iterations + len(rows),
            stop_reason="callback" if reason == "callback" else first.stop_reason,
            frame=problem.frame,
            history=[*first.history, *rows],
            first=replace(first, scene=started, frame=problem.frame),
        )


def _relative(change: Tensor, whole: Tensor) -> float:
    return float(change.norm() / whole.norm().clamp_min(1e-30))


def on_device(device: torch.device, network: DenoisingNetwork) -> DenoisingNetwork:
    """A network on a device; others may use it where it is."""
    if all(each.device == device for each in network.parameters()):
        return network
    return deepcopy(network).to(device)
