"""Whether a PSF explains a measurement; if not, what would, in a sentence for the user.

A scene that is solved for with the camera's PSF predicts pixels that were left out of the fit
(`Prediction`). One that does not is no scene of this PSF: then others are tried on coarse pixels,
and what explains clearly more is named.
"""

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.amounts import amount
from nolens.camera import Measurement
from nolens.camera.psf import has_finer_detail, reaches_edges
from nolens.errors import NolensError
from nolens.operators import PixelRectangle
from nolens.optics.magnification import magnified
from nolens.solvers.held_out import Prediction, Weight, predict
from nolens.solvers.inputs import support_of, tensor_of
from nolens.solvers.problem import Prior
from nolens.solvers.reconstructor import Method, Reconstructor
from nolens.solvers.result import Result, still_to_go

_WELL = 0.9
"""Explained fraction of the signal from which nothing is tried."""
_BADLY = 0.5
"""Explained fraction below which the PSF is not the measurement's."""
_CLEARLY = 0.1
"""Explained fraction by which another reading must be better to be named."""
_EXCHANGED = 0.25
"""The same for exchanged files."""
_FAIRLY = 0.8
"""Explained fraction that another size or support must reach to be named."""
_BURIED = 0.7
"""Fraction of the contrast that is noise, above which nothing can be told."""
_PIXELS = 60_000
"""Sensor pixels that predictions are made with."""
_MAGNIFICATIONS = (0.97, 0.99, 1.01, 1.03)
_ERRORS = 2.0
"""Standard errors by which it must be below that."""
_UNKNOWN = (
    ": was the camera refocused or moved, or is it the PSF of another camera, or mirrored? Take "
    "the PSF anew with the settings of the measurement"
)
_MOVES = 0.1
"""Relative distance that a picture still has to go, from which more iterations are advised."""
_STEP = 1e-3
"""Relative change of the picture in an iteration, below which it stands still."""


@dataclass(frozen=True)
class Explanation:
    """How much of a measurement a PSF explains.

    Parameters
    ----------
    prediction
        Of held-out pixels; None where they were too few.
    warnings
        Sentences to show.
    """

    prediction: Prediction | None
    warnings: tuple[str, ...] = ()


def explain(
    reconstructor: Reconstructor, measurement: Measurement, weight: Weight | None, psf_source: str
) -> Explanation:
    """Whether a measurement is one of a reconstructor's PSF and support.

    Parameters
    ----------
    reconstructor
        Of the measurement.
    measurement
        What is to be solved.
    weight
        The choice of τ, whose prediction is taken; without one it costs a few tens of
        iterations on coarse pixels.
    psf_source
        Where the PSF comes from, for messages.
    """
    trials = _Trials(reconstructor, measurement)
    prediction = None if weight is None else weight.prediction
    if prediction is None and reconstructor.method is not Method.WIENER:
        prediction = trials.of_all()
    if prediction is None or prediction.unexplained_by_noise > _BURIED:
        return Explanation(prediction)
    if prediction.explained >= _WELL:
        return Explanation(prediction)
    cause = trials.cause(psf_source)
    return Explanation(prediction, () if cause is None else (cause,))


def unfinished_warning(result: Result, *, supported: bool) -> str | None:
    """What helps where a run reached its limit while the picture still moved; None otherwise.

    Parameters
    ----------
    result
        Of the run.
    supported
        Whether the scene has a support.
    """
    if result.stop_reason != "iteration limit" or not result.history:
        return None
    step = result.history[-1]["scene_change"]
    if step <= _STEP or still_to_go(result.history) <= _MOVES:
        return None
    support = "" if supported else "a support of the scene (--support), "
    return (
        f"the limit of {result.iterations} iterations was reached while the picture still changes "
        f"by {_percent(step)} in each: {support}larger pixels (--bin 2) or more --iterations help"
    )


class _Trials:
    """Predictions on coarse pixels of the brightest channel, with other files and supports."""

    def __init__(self, reconstructor: Reconstructor, measurement: Measurement) -> None:
        self._all = replace(
            reconstructor,
            prior=Prior.TV if reconstructor.prior == Prior.NONE else reconstructor.prior,
            method=Method.ADMM,
        )
        self._measurement = measurement
        self._sensor = measurement.size
        self._by = math.ceil(math.sqrt(math.prod(self._sensor) / _PIXELS))
        power = torch.where(measurement.valid, measurement.values, 0).square().sum((-2, -1))
        channel = int(power.argmax())
        psf = tensor_of(reconstructor.psf, "PSF")
        self._psf = psf[channel % len(psf)][None]
        self._data = measurement.values[channel : channel + 1]
        self._valid = measurement.valid[channel : channel + 1]

    def of_all(self) -> Prediction | None:
        """Of all channels, as they are."""
        measurement = self._measurement
        return predict(self._all.coarse_problem(measurement.values, measurement.valid, self._by))

    def cause(self, psf_source: str) -> str | None:
        """The sentence for a measurement that is badly explained; None where it is not."""
        support = support_of(self._all.support, self._sensor)
        now = self._of(self._psf, support)
        if now is None or now.unexplained_by_noise > _BURIED or now.explained >= _WELL:
            return None
        error = float(now.blocks.std()) / math.sqrt(len(now.blocks))
        badly = now.explained + _ERRORS * error / (1 - now.unexplained_by_noise) < _BADLY
        if badly and has_finer_detail(self._data, self._psf):
            return None  # It was said with the PSF.
        remedy = (
            self._exchange(now)
            or self._size(now, support)
            or self._larger_support(now, support)
            or (_UNKNOWN if badly else None)
        )
        if remedy is None:
            return None
        return (
            f"{_percent(now.unexplained)} of the local contrast of the measurement "
            f"{self._measurement.source} is not explained by the PSF {psf_source}, and noise alone "
            f"would be {_percent(now.unexplained_by_noise)}{remedy}"
        )

    def _exchange(self, now: Prediction) -> str | None:
        """What is said where PSF and measurement explain each other better the other way round."""
        height, width = self._sensor
        rows, columns = self._psf.shape[-2:]
        top, left = (rows - height) // 2, (columns - width) // 2
        middle = self._psf[:, top : top + height, left : left + width]
        solver = replace(self._all, psf=self._data.clamp_min(0), support=None)
        try:
            exchanged = predict(solver.coarse_problem(middle, None, self._by))
        except NolensError:  # What is no PSF explains nothing.
            return None
        least = max(_BADLY, now.explained + _EXCHANGED)
        if exchanged is None or exchanged.explained < least:
            return None
        rest = _percent(exchanged.unexplained)
        return f". With the two files exchanged it is {rest}: they seem to be swapped"

    def _larger_support(self, now: Prediction, support: PixelRectangle | None) -> str | None:
        """What is said where light comes from beyond the support."""
        # Without one, the light that a cut PSF lacks would come from there; and what is missing
        # from another camera's finds some place.
        if support is None or reaches_edges(self._psf, self._sensor):
            return None
        free = self._of(self._psf, None)
        least = max(_FAIRLY, now.explained + _CLEARLY)
        if free is None or free.explained < least:
            return None
        return (
            f". Without the support of {support.height}×{support.width} pixels it is "
            f"{_percent(free.unexplained)}: light comes from beyond it too. Give a larger one "
            "(--support), or none"
        )

    def _size(self, now: Prediction, support: PixelRectangle | None) -> str | None:
        """What is said where the PSF of another distance explains more."""
        best, size = max(_FAIRLY, now.explained + _CLEARLY), None
        for factor in _MAGNIFICATIONS:
            other = self._of(magnified(self._psf, factor), support)
            if other is not None and other.explained > best:
                best, size = other.explained, (factor, other)
        if size is None:
            return None
        factor, other = size
        larger, nearer = ("larger", "nearer") if factor > 1 else ("smaller", "farther")
        return (
            f". With a PSF that is {_percent(abs(factor - 1))} {larger} it is "
            f"{_percent(other.unexplained)}: the scene is {nearer} than the point source was, or "
            "the camera was refocused. Take the PSF at the distance of the scene, or refocus "
            "(nolens refocus)"
        )

    def _of(self, psf: Tensor, support: PixelRectangle | None) -> Prediction | None:
        solver = replace(self._all, psf=psf, support=support)
        return predict(solver.coarse_problem(self._data, self._valid, self._by))


def _percent(fraction: float) -> str:
    return amount(100 * min(fraction, 1.0), "%", digits=2)
