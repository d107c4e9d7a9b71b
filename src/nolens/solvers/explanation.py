"""Whether a PSF explains a measurement; if not, what would, in a sentence for the user.

A scene that is solved for with the camera's PSF predicts pixels that were left out of the fit
(`Prediction`). One that does not is no scene of this PSF: then others are tried on coarse pixels,
and what explains clearly more is named.
"""

from dataclasses import dataclass, replace
from typing import Any, Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.amounts import percent
from nolens.camera import FieldPsf, Measurement
from nolens.camera.psf import has_finer_detail, reaches_edges
from nolens.errors import NolensError
from nolens.optics.magnification import magnified
from nolens.solvers.held_out import Prediction, Weight, box_mean
from nolens.solvers.inputs import support_of, tensor_of
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.reconstructor import Method, Reconstructor, judged_side
from nolens.solvers.result import Result, stands_still

_WELL = 0.97
"""Explained fraction of the signal from which nothing is tried."""
_BADLY = 0.5
"""Explained fraction below which the PSF is not the measurement's."""
_WORTH = 0.02
"""Explained fraction by which another reading must be better to be named."""
_EXCHANGED = 0.25
"""Explained fraction by which exchanged files must be better to be named."""
_FAIRLY = 0.8
"""Explained fraction that no support must reach to be the only cause that is named."""
_BURIED = 0.5
"""Fraction of the contrast that is noise, above which nothing can be told of the PSF."""
_ALL = 0.9
"""The same, above which all of it may be noise."""
_SQUARES, _EVEN = 12, 2.0
"""Squares along the shorter side whose means are looked at, and their variance over that of noise
up to which they are even."""
_UNKNOWN = (
    "was the camera refocused or moved, is it the PSF of another camera, or the measurement a "
    "picture that a program developed? Give files as the sensor measured them, with the same "
    "settings"
)
_SHARPENINGS = 4
_DARK = 1e-6
"""Of the PSF's peak, added against division by zero."""
_BESIDE = 0.1
"""Fraction of the light that comes from beside the sensor's frame where a scene fills the view."""

_OTHERS = (Prior.NONE, Prior.COLOUR_TV)
"""Priors that say nothing of one channel."""


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


@dataclass(frozen=True)
class FieldChoice:
    """Whether PSFs over the field are used, or one for all of the scene.

    Parameters
    ----------
    reconstructor
        With what is used.
    left_out
        How many PSFs over the field are not.
    over_field, one
        Of held-out pixels, with either; None where nothing was compared.
    """

    reconstructor: Reconstructor
    left_out: int = 0
    over_field: Prediction | None = None
    one: Prediction | None = None

    @property
    def warnings(self) -> tuple[str, ...]:
        """About PSFs that are left out."""
        if not self.left_out or self.over_field is None or self.one is None:
            return ()
        return (
            "one PSF is used for all of the scene: it leaves "
            f"{percent(self.one.unexplained)} of the local contrast unexplained, the "
            f"{self.left_out} PSFs over the field {percent(self.over_field.unexplained)}. Between "
            "their angles it changes too much to be interpolated, or they are not this camera's: "
            "capture more angles (nolens calibrate plan --error 10% says which); "
            f"--field-points {self.left_out} uses them all the same",
        )

    def row(self) -> dict[str, Any]:
        """For the run's record."""
        return {
            "left_out": self.left_out,
            "unexplained": None if self.over_field is None else self.over_field.unexplained,
            "unexplained_by_one": None if self.one is None else self.one.unexplained,
        }


SupportBy = Literal["measurement", "person", "camera"]
"""What tells the support of a scene."""


def choose_field(
    reconstructor: Reconstructor, measurement: Measurement, alone: Tensor | None = None
) -> FieldChoice:
    """Whether PSFs over the field are used: not where one explains the measurement clearly better.

    So it does where the PSF changes more between the angles than can be interpolated
    (decision 18). It costs a few tens of iterations with either, on coarse pixels of one channel.

    Parameters
    ----------
    reconstructor
        Of the measurement, with its support.
    measurement
        What is to be solved.
    alone
        The one, (channels, height, width); None takes the reconstructor's.
    """
    field_psf = reconstructor.field_psf
    if field_psf is None or field_psf.points == 1 or reconstructor.method is Method.WIENER:
        return FieldChoice(reconstructor)
    single = replace(
        reconstructor, psf=reconstructor.psf if alone is None else alone, field_psf=None
    )
    over_field = _Trials(reconstructor, measurement).of_brightest()
    one = _Trials(single, measurement).of_brightest()
    if over_field is None or one is None or not one.is_clearly_better(over_field):
        return FieldChoice(reconstructor, 0, over_field, one)
    return FieldChoice(single, field_psf.points, over_field, one)


def explain(
    reconstructor: Reconstructor,
    measurement: Measurement,
    weight: Weight | None,
    psf_source: str,
    *,
    support_by: SupportBy = "measurement",
) -> Explanation:
    """Whether a measurement is one of a reconstructor's PSF and support.

    Parameters
    ----------
    reconstructor
        Of the measurement.
    measurement
        What is to be solved.
    weight
        The choice of τ, whose prediction is taken; without one, and with PSFs over the field,
        it costs a few tens of iterations on coarse pixels.
    psf_source
        Where the PSF comes from, for messages.
    support_by
        What tells the support: one that a person states may be the cause.
    """
    trials = _Trials(reconstructor, measurement)
    # A weight is chosen with the PSF of the axis alone.
    single = reconstructor.field_psf is None
    prediction = weight.prediction if weight is not None and single else None
    if prediction is None and reconstructor.method is not Method.WIENER:
        prediction = trials.of_all()
    if prediction is None:
        return Explanation(prediction)
    # What noise buries here may be seen on coarse pixels.
    if prediction.explained >= _WELL and prediction.unexplained_by_noise <= _BURIED:
        return Explanation(prediction)
    cause = trials.cause(psf_source, support_by)
    return Explanation(prediction, () if cause is None else (cause,))


def picture_warnings(
    problem: Problem, result: Result, psf: Tensor, iterations: int | None
) -> tuple[str, ...]:
    """What may be better about a picture than it is, in sentences.

    Parameters
    ----------
    problem, result
        What was solved, and what came of it.
    psf
        (channels, height, width), as it was used.
    iterations
        The limit that a person set; then, and of a run that was interrupted, nothing is said.
    """
    if iterations is not None or not result.history or result.stop_reason == "callback":
        return ()
    texts = (_filled_view_warning(problem, result, psf), _unfinished_warning(problem, result))
    return tuple(text for text in texts if text is not None)


def _filled_view_warning(problem: Problem, result: Result, psf: Tensor) -> str | None:
    # Light that a cut PSF lacks is put beside the sensor's frame, too.
    if problem.forward.support is not None or reaches_edges(psf, problem.forward.sensor):
        return None
    top, left, height, width = problem.frame
    beside = result.scene.clone()
    beside[:, top : top + height, left : left + width] = 0
    fraction = float(problem.forward(beside).sum() / problem.forward(result.scene).sum())
    if not fraction > _BESIDE:
        return None
    return (
        f"{percent(fraction)} of the light seems to come from beside the sensor's frame, from "
        "where only a part of the PSF falls on the sensor: the scene fills the view, and comes out "
        "poor. If it is smaller, say so (--support); otherwise go farther away, or keep light from "
        "the side out with a hood"
    )


def _unfinished_warning(problem: Problem, result: Result) -> str | None:
    # Turns of a network are of a number that is known; with --iterations there would be none.
    minimised = result.first is None
    iterated = result.first or result
    if iterated.stop_reason != "iteration limit" or stands_still(iterated.history):
        return None
    remedies = [
        *([] if problem.forward.support else ["a support of the scene (--support)"]),
        "larger pixels (--bin 2)",
        *(["more --iterations"] if minimised else []),
    ]
    step = iterated.history[-1]["scene_change"]
    return (
        f"the limit of {iterated.iterations} iterations was reached while the picture still "
        f"changes by {percent(step)} in each: {' or '.join(remedies)} would help"
    )


@dataclass(frozen=True)
class _Reading:
    """Other files or another support that explain clearly more, and what is said of them."""

    prediction: Prediction
    text: str


class _Trials:
    """Predictions on coarse pixels of the brightest channel, with other files and supports."""

    def __init__(self, reconstructor: Reconstructor, measurement: Measurement) -> None:
        self._measurement, self._sensor = measurement, measurement.size
        self._all = replace(
            reconstructor,
            prior=Prior.TV if reconstructor.prior in _OTHERS else reconstructor.prior,
            method=Method.ADMM,
        )
        channel = measurement.brightest
        psf = tensor_of(reconstructor.psf, "PSF")
        self._psf = psf[channel % len(psf)][None]
        field_psf = reconstructor.field_psf
        if field_psf is not None:
            channels = field_psf.values.shape[1]
            field_psf = replace(field_psf, values=field_psf.values[:, channel % channels, None])
        self._single = field_psf is None
        self._solver = replace(self._all, psf=self._psf, field_psf=field_psf)
        self._data = measurement.values[channel : channel + 1]
        self._valid = measurement.valid[channel : channel + 1]

    def of_all(self) -> Prediction | None:
        """Of all channels, as they are."""
        return self._all.predict(self._measurement)

    def of_brightest(self) -> Prediction | None:
        """Of the brightest channel, with the measurement in the linear step in any case."""
        one = FieldPsf(self._psf[None], torch.zeros(1, 2))
        solver = replace(self._solver, field_psf=self._solver.field_psf or one)
        return solver.predict(self._data, self._valid)

    def cause(self, psf_source: str, support_by: SupportBy) -> str | None:
        """The sentence for a measurement that is badly explained; None where it is not."""
        now = self._solver.predict(self._data, self._valid)
        if now is None:
            return None
        if now.unexplained_by_noise > _ALL and not now.explains_anything and self._is_even():
            return self._nothing()
        if now.explained >= _WELL:
            return None
        buried = now.unexplained_by_noise > _BURIED
        badly = now.explains_less(_BADLY) and not buried
        if badly and has_finer_detail(self._data, self._psf):
            return None  # It was said with the PSF.
        readings: list[_Reading | None] = []
        if self._single and not buried:
            readings += [self._exchange(now) or self._size(now) or self._sharper(now)]
        # Noise hides how much a PSF explains, but not that another support explains more. Beyond
        # what the camera accepts, light would explain a model's errors.
        if support_by == "person" or (support_by == "measurement" and not buried):
            readings += [self._larger_support(now)]
        named = [each for each in readings if each is not None]
        if named:
            remedy = max(named, key=lambda each: each.prediction.explained).text
        elif badly:
            remedy = self._unknown(support_by)
        else:
            return None
        side = judged_side(self._sensor)
        # The report's are the finest.
        larger = "" if side == 1 else f", in means over {side}×{side} pixels,"
        return (
            f"{percent(now.unexplained)} of the local contrast of "
            f"{self._measurement.source}{larger} is not explained by the PSF {psf_source}, and "
            f"noise alone would be {percent(now.unexplained_by_noise)}{remedy}"
        )

    def _is_even(self) -> bool:
        """Whether means of large squares scatter as white noise does: no slow light is seen."""
        side = max(min(self._sensor) // _SQUARES, 1)
        light = self._data.double() - self._data.double().mean()
        means, squares = (nnf.avg_pool2d(each[None], side) for each in (light, light**2))
        of_noise = float((squares - means**2).mean()) / side**2
        return float(means.var()) <= _EVEN * of_noise

    def _nothing(self) -> str:
        """What is said where nothing but noise is seen."""
        return (
            f"{self._measurement.source} shows nothing of a scene above its noise: "
            "is it a dark frame? Otherwise take it with more light or a longer exposure, or "
            "average several frames"
        )

    def _exchange(self, now: Prediction) -> _Reading | None:
        """What is said where PSF and measurement explain each other better the other way round."""
        if now.explained + _EXCHANGED > 1:
            return None
        height, width = self._sensor
        rows, columns = self._psf.shape[-2:]
        top, left = (rows - height) // 2, (columns - width) // 2
        middle = self._psf[:, top : top + height, left : left + width]
        solver = replace(self._solver, psf=self._data.clamp_min(0), support=None)
        try:
            exchanged = solver.predict(middle)
        except NolensError:  # What is no PSF explains nothing.
            return None
        least = max(_BADLY, now.explained + _EXCHANGED)
        if exchanged is None or exchanged.explained < least:
            return None
        rest = percent(exchanged.unexplained)
        return _Reading(
            exchanged, f". With the two files exchanged it is {rest}: they seem to be swapped"
        )

    def _larger_support(self, now: Prediction) -> _Reading | None:
        """What is said where light comes from beyond the support."""
        support = support_of(self._solver.support, self._sensor)
        # Without one, the light that a cut PSF lacks would come from there.
        if support is None or reaches_edges(self._psf, self._sensor):
            return None
        free = replace(self._solver, support=None).predict(self._data, self._valid)
        if free is None or not _is_named(free, now):
            return None
        cause = "light comes from beyond it too. Give a larger one (--support), or none"
        # What is missing from another camera's finds some place.
        if free.explained < _FAIRLY or now.unexplained_by_noise > _BURIED:
            cause = (
                "is the scene larger, or beside it? State a larger one (--support), or none. If it "
                f"is not, {_UNKNOWN}"
            )
        return _Reading(
            free,
            f". Without the support of {support.height}×{support.width} pixels it is "
            f"{percent(free.unexplained)}: {cause}",
        )

    def _unknown(self, support_by: SupportBy) -> str:
        """What is said where nothing that was tried explains clearly more."""
        support = support_of(self._solver.support, self._sensor)
        if support is None or support_by != "person":
            return f": {_UNKNOWN}"
        return (
            f": is the scene larger than its stated support of {support.height}×{support.width} "
            f"pixels, or beside it? State a larger one, or none. If it is not, {_UNKNOWN}"
        )

    def _size(self, now: Prediction) -> _Reading | None:
        """What is said where the PSF of another distance explains more."""
        tried = {factor: self._of(magnified(self._psf, factor)) for factor in (0.99, 1.01)}

        def rest(factor: float) -> float:
            return tried[factor].unexplained

        nearest = min(tried, key=rest)
        if rest(nearest) >= now.unexplained:
            return None
        further = 1 + 3 * (nearest - 1)
        tried[further] = self._of(magnified(self._psf, further))
        factor = min(tried, key=rest)
        other = tried[factor]
        if not _is_named(other, now):
            return None
        larger, nearer = ("larger", "nearer") if factor > 1 else ("smaller", "farther")
        return _Reading(
            other,
            f". With a PSF that is {percent(abs(factor - 1))} {larger} it is "
            f"{percent(other.unexplained)}: the scene is {nearer} than the point source was, or "
            "the camera was refocused. Take the PSF at the distance of the scene, or refocus "
            "(nolens refocus)",
        )

    def _sharper(self, now: Prediction) -> _Reading | None:
        """What is said where a PSF with less blur explains more."""
        other = self._of(_sharpened(self._psf, 2 * judged_side(self._sensor) + 1))
        if not _is_named(other, now):
            return None
        return _Reading(
            other,
            f". With a sharper PSF it is {percent(other.unexplained)}: the point source was out of "
            "focus, or too large, or moved. Take the PSF anew, with a smaller and steady source at "
            "the distance of the scene",
        )

    def _of(self, psf: Tensor) -> Prediction:
        """With another PSF; once there are pixels enough for the PSF as it is."""
        prediction = replace(self._solver, psf=psf).predict(self._data, self._valid)
        assert prediction is not None
        return prediction


def _is_named(other: Prediction, now: Prediction) -> bool:
    return other.is_clearly_better(now) and other.explained > now.explained + _WORTH


def _sharpened(psf: Tensor, side: int) -> Tensor:
    """Less blurred, by a few of Richardson's iterations (`richardson1972`)."""

    def soft(plane: Tensor) -> Tensor:
        return box_mean(box_mean(plane, side), side)

    blurred = psf.clamp_min(0) + _DARK * psf.max()
    sharp = blurred
    for _ in range(_SHARPENINGS):
        sharp = sharp * soft(blurred / soft(sharp))
    return sharp
