"""A sequence of measurements by a trained prior, each from where the one before it ended."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import torch
from torch import Tensor

from nolens.errors import DivergenceError
from nolens.solvers.inputs import Plane
from nolens.solvers.plug_and_play import Fit, PlugAndPlay, Turn, on_device
from nolens.solvers.problem import Problem
from nolens.solvers.stream import Deadline, Frame, check_frame_limits, is_cut

TURNS = 4
"""Of a frame after the first."""
_WIDEST, _NARROWEST = 0.3, 0.15
"""Spreads of the first and the last of them (decision 24)."""
_ALONE = 0.25
"""That of a frame with one turn."""
_ANY = 3.0
"""How far a picture is from the scene that says nothing of it."""
_OWN_NOISE = 0.3
"""Noise in a fit near any picture (`Fit.own_noise`) that they are for. They are less by its ratio
where there is less, and more by the root of that where there is more."""
_MUCH, _IN_MUCH = 0.2, 0.8
"""That above which the strength is less than a photo's, by that factor."""


class Photo(Protocol):
    """What a stream takes of a photo; a `Result` or a `Frame`."""

    @property
    def scene(self) -> Tensor:
        """(channels, height, width), in units of measurement over PSF."""

    @property
    def iterations(self) -> int:
        """That it took."""


class TrainedStream:
    """Reconstructs frame after frame of one camera by turns of a network (`PlugAndPlay`).

    The first frame is solved as a photo is, and so is one that shows another scene (`is_cut`). The
    others go on from fit, picture and multiplier of the one before, with a few turns whose spread
    falls from a wide one, so that what moves is followed and what stands gathers the light of many
    frames.

    Parameters
    ----------
    problem
        Of the first measurement; all others have its sizes.
    prior
        The network.
    photo
        Solves a problem as a photo is, as `Reconstructor.solve` does.
    iterations
        Turns of every frame after the first, ≥ 1.
    latency_s
        Seconds that a frame may take, counted from the call: it ends with the last turn that is
        over before, one at the least. None for no bound.

    Raises
    ------
    OptionError
        If `iterations` or `latency_s` is not above 0.
    """

    def __init__(
        self,
        problem: Problem,
        prior: PlugAndPlay,
        photo: Callable[..., Photo],
        *,
        iterations: int = TURNS,
        latency_s: float | None = None,
    ) -> None:
        check_frame_limits(iterations, latency_s)
        self._problem, self._prior, self._photo = problem, prior, photo
        network = on_device(problem.data.device, prior.network)
        self._spreads = _spreads(iterations)
        self._following = replace(prior, network=network, spreads=self._spreads)
        self._latency_s = latency_s
        self._fit: Fit | None = None
        self._strength = 1.0
        self._picture = torch.empty(0)
        self._last: Turn | None = None
        self._residual = float("inf")
        self.cuts = 0
        """Frames so far that were of another scene than the one before."""

    @property
    def weight(self) -> float:
        """Of total variation in the photograph that the first turns start from."""
        return self._problem.weight

    @torch.no_grad()
    def start(self, data: Plane, valid: Plane | None, scene: Tensor) -> None:
        """Go on from a picture, as if it were the stream's own of the frame before.

        Parameters
        ----------
        data, valid
            Of its measurement, as `Problem.build` takes them.
        scene
            The picture, (channels, height, width), in units of measurement over PSF.

        Raises
        ------
        DataError
            As by `solve`.
        """
        self._start(self._problem.measuring(data, valid), scene)

    @torch.no_grad()
    def solve(self, data: Plane, valid: Plane | None = None) -> Frame:
        """Reconstruct the next frame.

        Parameters
        ----------
        data, valid
            As `Problem.build` takes them.

        Raises
        ------
        DataError
            If the frame has other sizes than the first, or cannot be solved for. The stream goes
            on with the next one as if this had not been.
        DivergenceError
            If a picture is NaN or infinite; the next frame starts anew.
        """
        begun = time.perf_counter()
        problem = self._problem.measuring(data, valid)
        before, fit = self._residual, self._fit
        if fit is not None:
            self._residual = _residual(problem, self._picture)
            if is_cut(self._residual, before):
                self.cuts, fit = self.cuts + 1, None
        deadline = Deadline(begun, self._latency_s)
        if fit is None:
            scene, iterations = self._anew(problem, deadline)
        else:
            scene, iterations = self._next(fit, problem, deadline)
        return Frame(scene, iterations, time.perf_counter() - begun, problem.frame)

    def _anew(self, problem: Problem, deadline: Deadline) -> tuple[Tensor, int]:
        """The scene of a frame that is solved as a photo is, and its iterations and turns."""
        self._fit = None
        photo = self._photo(problem, callback=deadline)
        self._start(problem, photo.scene)
        return photo.scene, photo.iterations

    def _start(self, problem: Problem, scene: Tensor) -> None:
        """Have the next frame go on from a picture of a measurement."""
        fit = self._fit = Fit(problem, scene)
        strength = fit.strength(self._prior.spreads[-1])
        own = fit.own_noise(self._prior.spreads[-1], _ANY)
        ratio = own / _OWN_NOISE if math.isfinite(own) else 1.0
        strength *= _IN_MUCH if _MUCH < own < math.inf else 1.0
        self._strength = strength / math.sqrt(self._prior.detail)
        spreads = tuple(min(ratio, math.sqrt(ratio)) * each for each in self._spreads)
        self._following = replace(self._following, spreads=spreads)
        self._picture, self._last = scene, None

    def _next(self, fit: Fit, problem: Problem, deadline: Deadline) -> tuple[Tensor, int]:
        """The scene of a frame that goes on from the one before, and its turns."""
        fit.measure(problem)
        after = None if self._last is None else replace(self._last, number=-1)
        turns = self._following.turns(problem, self._picture, self._strength, fit, after)
        last = next(turns)
        while not deadline.is_over() and (turn := next(turns, None)) is not None:
            last = turn
        if not bool(torch.isfinite(last.picture).all()):
            self._fit = None
            raise DivergenceError("a turn of the network gave NaN or infinity: the frame is lost")
        self._last, self._picture = last, last.scene
        shown = self._prior.refinement
        picture = last if shown is None else replace(last, picture=shown(last))
        return picture.scene, last.number + 1


def _spreads(turns: int) -> tuple[float, ...]:
    """Of so many turns of a frame."""
    if turns == 1:
        return (_ALONE,)
    ratio = (_NARROWEST / _WIDEST) ** (1 / (turns - 1))
    return tuple(_WIDEST * ratio**number for number in range(turns))


def _residual(problem: Problem, scene: Tensor) -> float:
    """‖b − x‖ / ‖b‖ of a measurement and a scene as it was measured."""
    light = torch.where(problem.valid, problem.forward(scene / problem.scale), 0)
    missed = (problem.scale * (problem.data - light)).norm()
    return float(missed / (problem.scale * problem.data).norm())
