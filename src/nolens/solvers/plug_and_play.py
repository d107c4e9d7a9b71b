"""Plug-and-play: a trained network in turn with the fit of the measurement."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial

import torch
from torch import Tensor

from nolens.solvers.admm_state import Penalties
from nolens.solvers.denoising_network import BANDS, DenoisingNetwork, denoise
from nolens.solvers.held_out import channel_noise
from nolens.solvers.linear_step import LinearStep
from nolens.solvers.problem import Problem
from nolens.solvers.result import Callback, Progress, Result, follow

_WHITE = 0.995
"""Fraction of the scene's values below its white."""
_BYTES_PER_PIXEL = 120
"""Held in the fit, per pixel of the padded shape."""
_SLOW = 1 / 16
"""Weight of the picture itself beside that of its differences."""


def plug_and_play_bytes(pixels: float, network: DenoisingNetwork) -> float:
    """Most memory that a run holds at once, for so many `Problem.padded_pixels`."""
    return pixels * _BYTES_PER_PIXEL + network.tile_bytes


class Fit:
    r"""The scene that fits a measurement, near a picture z; all in units of a white.

    .. math:: x = \arg\min_v \tfrac12 ‖(b − Av)/σ‖^2 + \tfrac{1}{2 s^2}
       \left(‖Ψ(v − z)‖^2 + ‖v − z‖^2 / 16\right)

    with the differences Ψ: what a picture misses of a scene is, as scenes are, the smaller the
    finer it is, so that its slow part is left to the measurement. A few steps of conjugate
    gradients go from z to x. The noise of the measurement in x is that of the circulant mean.

    Parameters
    ----------
    problem
        In normalised units; its prior and weight do not matter.
    detail
        What the measured noise is divided by.
    """

    def __init__(self, problem: Problem, detail: float = 1.0) -> None:
        self._noise = channel_noise(problem) / detail
        self.scale = problem.scale.flatten()
        self.white = 1.0
        zero = problem.data.new_zeros(1, *problem.scene_shape[1:])
        self.steps = [
            LinearStep(problem.single(each), zero, varied=True) for each in range(problem.channels)
        ]

    def in_whites(self, picture: Tensor) -> Tensor:
        """A picture in units of its own white, which becomes that of the fit."""
        values = picture.flatten()
        bright = float(torch.quantile(values[:: 1 + values.numel() // 10**6], _WHITE))
        if not 0 < bright < math.inf:
            return picture
        self.white *= bright
        return picture / bright

    def penalties(self, channel: int, spread: float) -> Penalties:
        """What the linear step weighs differences and the picture itself with."""
        unit = self.white / self.scale[channel]  # normalised values of a white
        weight = float((self._noise[channel] / (spread * unit)) ** 2)
        return 0.0, weight, _SLOW * weight

    def near(self, picture: Tensor, spread: float) -> tuple[Tensor, Tensor]:
        """X, and the noise in it of each channel and band, (channels, `BANDS`).

        Parameters
        ----------
        picture
            z, (channels, height, width).
        spread
            s: how far the differences of z may be from the scene's.
        """
        fitted, noise = [], []
        for number, step in enumerate(self.steps):
            unit, penalties = self.white / self.scale[number], self.penalties(number, spread)
            step.v = (unit * picture[number : number + 1]).contiguous()
            step.renew_residual()
            target = step.prior_part(penalties, step.v)
            step.solve(target, penalties)
            fitted.append(step.v / unit)
            noise.append(self._noise[number] / unit * step.noise_gain(penalties, BANDS))
        return torch.cat(fitted), torch.stack(noise)


@dataclass(frozen=True)
class Turn:
    """One turn of fit and network, in units of the white.

    Parameters
    ----------
    fit
        x, (channels, height, width).
    noise
        In it, of each channel and band.
    picture
        What the network makes of it, and not below zero.
    white
        In units of measurement over PSF.
    """

    fit: Tensor
    noise: Tensor
    picture: Tensor
    white: float

    @property
    def scene(self) -> Tensor:
        """The picture in units of measurement over PSF."""
        return self.picture * self.white


@dataclass(frozen=True)
class PlugAndPlay:
    r"""A prior that is a network; it takes turns with the fit (half-quadratic splitting).

    x is the `Fit` near the picture before, with spreads s₁ > s₂ > …, and the picture z = D(x)₊, as
    `zhang2022` have it. There is no objective, so the number of turns
    is fixed. The brightness of the scene's white, of which spreads are fractions, is taken
    anew from each picture. It starts from a photograph by total variation.

    Parameters
    ----------
    network
        D: takes out the noise that the fit leaves.
    spreads
        Of each turn, in units of the white.
    facts
        What a record says of it: the prior, and the hash of its weights.
    detail
        What the noise of the measurement is divided by: 2 shows more detail and more noise.
    """

    network: DenoisingNetwork = field(repr=False)
    spreads: tuple[float, ...]
    facts: dict[str, str] = field(default_factory=dict)
    detail: float = 1.0

    def turns(self, problem: Problem, photograph: Tensor) -> Iterator[Turn]:
        """All turns, one after the other.

        Parameters
        ----------
        problem
            In normalised units.
        photograph
            To start from, in units of measurement over PSF.
        """
        fit = Fit(problem, self.detail)
        picture = fit.in_whites(photograph)
        network = self.network.to(problem.data.device)
        for number, spread in enumerate(self.spreads):
            x, noise = fit.near(picture, spread)
            picture = denoise(network, x, noise, spread, number).clamp_min(0)
            yield Turn(x, noise, picture, fit.white)
            picture = fit.in_whites(picture)

    def solve(self, problem: Problem, first: Result, callback: Callback | None = None) -> Result:
        """The scene of a problem.

        Parameters
        ----------
        problem
            In normalised units; its prior and weight do not matter.
        first
            A photograph to start from, by total variation.
        callback
            Sees each turn, and stops the run by returning True.

        Raises
        ------
        DivergenceError
            If a picture is NaN or infinite.
        """
        scene = first.scene / problem.scale

        def checks() -> Iterator[Progress]:
            nonlocal scene
            for number, turn in enumerate(self.turns(problem, first.scene)):
                before, scene = scene, turn.scene / problem.scale
                change = _relative(scene - before, scene)
                yield Progress(
                    iteration=first.iterations + number + 1,
                    objective=problem.objective(scene),
                    primal_residual=_relative(turn.fit - turn.picture, turn.picture),
                    dual_residual=change,
                    scene_change=change,
                    penalties=(self.spreads[number],),
                    scene=partial(torch.clone, scene),
                    expected=first.iterations + len(self.spreads),
                )

        rows, reason = follow(checks(), lambda _: False, callback)
        return Result(
            scene=problem.unscale(scene),
            objective=problem.objective(scene),
            iterations=first.iterations + len(rows),
            stop_reason="callback" if reason == "callback" else first.stop_reason,
            frame=problem.frame,
            history=[*first.history, *rows],
            first=first,
        )


def _relative(change: Tensor, whole: Tensor) -> float:
    return float(change.norm() / whole.norm().clamp_min(1e-30))
