"""What a reconstruction came to: noise, unexplained part, resolution, support, and the run."""

import math
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from nolens.amounts import amount, duration_text, finite_or_none, percent
from nolens.solvers.development import finest_detail
from nolens.solvers.held_out import Prediction, fit, pixel_noise
from nolens.solvers.problem import Problem
from nolens.solvers.result import Result, stands_still

_CONTRAST = 0.1
"""Of the bars whose resolution is reported, to the mean radiance."""
_PERIODS = 3
"""Of the bars, along each side of their square."""
_VISIBLE = 5.0
"""Signal-to-noise ratio at which a thing is seen (`rose1948`)."""
_RINGS = 100
_NYQUIST = 0.5


@dataclass(frozen=True)
class Report:
    """Figures of a reconstruction; `lines` says them.

    Parameters
    ----------
    noise
        Standard deviation of a pixel's noise over the mean of the measurement.
    prediction
        How much of the measurement the scene misses, of pixels that were left out of the fit or,
        where `held_out` is False, of all.
    held_out
        Which of the two.
    frequency
        Highest spatial frequency, in cycles per pixel, at which bars of 10 % contrast are seen
        above the noise (`resolved_frequency`); 0 for none.
    pixel_rad
        Angle of a scene pixel in the middle of the view; None where the camera is not known.
    support
        (height, width) in pixels that light was taken to come from.
    field_points
        PSFs over the field.
    left_out
        PSFs over the field that are not used, as one explains more.
    limited, automatic_support, acceptance
        Whether that is less than all the sensor can see, was chosen by the program, and is all
        that the camera accepts light from.
    method, iterations, stop_reason
        Of the run.
    tau, automatic_tau
        Weight of the prior, and whether it was chosen by the program.
    seconds
        That the run took, with the choice of the weight.
    device
        Where it was computed.
    """

    noise: float
    prediction: Prediction
    held_out: bool
    frequency: float
    pixel_rad: float | None
    support: tuple[int, int]
    field_points: int
    left_out: int
    limited: bool
    automatic_support: bool
    acceptance: bool
    method: str
    iterations: int
    stop_reason: str
    tau: float
    automatic_tau: bool
    seconds: float
    device: str

    @classmethod
    def of(
        cls,
        problem: Problem,
        result: Result,
        psf: Tensor,
        *,
        prediction: Prediction | None,
        method: str,
        automatic_tau: bool,
        automatic_support: bool,
        seconds: float,
        acceptance: bool = False,
        pixel_rad: float | None = None,
        left_out: int = 0,
    ) -> "Report":
        """The report of a run.

        Parameters
        ----------
        problem, result
            What was solved, and what came of it.
        psf
            (channels, height, width), as it was used.
        prediction
            Of held-out pixels; None takes the residual of the fit.
        method, automatic_tau, automatic_support, seconds, acceptance, pixel_rad, left_out
            As the report has them.
        """
        noise, missed = pixel_noise(problem), prediction or fit(problem, result.scene)
        if prediction is not None or result.first is not None:
            # Nothing fits their noise: what is more has the detail of a sharp PSF in it.
            least = min(missed.noise, missed.residual)
            noise *= least / missed.noise
            missed = replace(missed, noise=least)
        norms = (problem.scale * problem.psf_norm).double().flatten().cpu()
        counts = problem.valid.sum((-2, -1)).clamp_min(1)
        means = (problem.data.sum((-2, -1), dtype=torch.float64) / counts).cpu()
        mean = float((norms * means).mean())
        deviation = noise * float(norms.square().mean().sqrt())
        height, width = problem.scene_shape[-2:]
        return cls(
            noise=deviation / mean if mean > 0 else math.inf,
            prediction=missed,
            held_out=prediction is not None,
            frequency=resolved_frequency(problem, result.scene, psf, noise),
            pixel_rad=pixel_rad,
            support=(height, width),
            field_points=problem.forward.field_points,
            left_out=left_out,
            limited=problem.forward.support is not None,
            automatic_support=automatic_support,
            acceptance=acceptance,
            method=method,
            iterations=result.iterations,
            stop_reason=_reason(result),
            tau=problem.weight,
            automatic_tau=automatic_tau,
            seconds=seconds,
            device=str(problem.data.device),
        )

    @property
    def chi_square(self) -> float:
        """Power of what is not explained over that of the noise."""
        return (self.prediction.residual / self.prediction.noise) ** 2

    @property
    def resolution_pixels(self) -> float | None:
        """Width of the finest bars that are seen above the noise, half a period, in pixels."""
        return 1 / (2 * self.frequency) if self.frequency > 0 else None

    @property
    def lines(self) -> tuple[tuple[str, str], ...]:
        """Five lines, each its name and its text."""
        return (
            ("noise", f"{amount(100 * self.noise, '%', digits=2)} of the mean, in each pixel"),
            ("unexplained", self._unexplained),
            ("resolution", self._resolution),
            ("support", self._support),
            ("run", self._run),
        )

    def summary(self) -> dict[str, Any]:
        """Values that JSON has, the five lines among them."""
        return {
            "noise": finite_or_none(self.noise),
            "unexplained": self.prediction.unexplained,
            "unexplained_by_noise": self.prediction.unexplained_by_noise,
            "chi_square": self.chi_square,
            "held_out": self.held_out,
            "resolution_pixels": self.resolution_pixels,
            "resolution_mrad": self._resolution_mrad,
            "support_pixels": list(self.support),
            "limited": self.limited,
            "acceptance": self.acceptance,
            "lines": [list(line) for line in self.lines],
        }

    @property
    def _resolution_mrad(self) -> float | None:
        pixels = self.resolution_pixels
        return None if pixels is None or self.pixel_rad is None else 1e3 * pixels * self.pixel_rad

    @property
    def _unexplained(self) -> str:
        prediction = self.prediction
        where = "held-out pixels" if self.held_out else "the pixels of the fit"
        return (
            f"{percent(prediction.unexplained)} of the local contrast of {where}; noise alone "
            f"would be {percent(prediction.unexplained_by_noise)} "
            f"(χ² {amount(self.chi_square, digits=2)})"
        )

    @property
    def _resolution(self) -> str:
        pixels, mrad = self.resolution_pixels, self._resolution_mrad
        bars = f"bars of {percent(_CONTRAST)} contrast"
        if pixels is None:
            return f"{bars} drown in the noise"
        angle = ""
        if mrad is not None:
            degrees = amount(math.degrees(mrad / 1e3), digits=2)
            angle = f" ({amount(mrad, 'mrad', digits=2)}, {degrees}°)"
        return f"{amount(pixels, 'pixels', digits=2)}{angle}, for {bars} at this noise"

    @property
    def _support(self) -> str:
        height, width = self.support
        what = ", all that the camera accepts light from" if self.acceptance else ""
        what = what if self.limited else ", all that the sensor can see"
        return f"{height}×{width} pixels{what}{' (automatic)' if self.automatic_support else ''}"

    @property
    def _run(self) -> str:
        automatic = " (automatic)" if self.automatic_tau else ""
        seconds = self.seconds
        time = duration_text(seconds) if seconds >= 90 else amount(seconds, "s", digits=2)
        points = f"{self.field_points} PSFs over the field, " if self.field_points > 1 else ""
        if self.left_out:
            points = f"one PSF, as {self.left_out} over the field explain less, "
        steps = f"{self.iterations} iterations ({self.stop_reason}), "
        steps = "" if self.stop_reason == "one shot" else steps
        return f"{self.method}, {points}{steps}τ {self.tau:.3g}{automatic}, {time} on {self.device}"


def _reason(result: Result) -> str:
    """Why a run ended, as its line says it."""
    if result.stop_reason == "callback":
        return "interrupted"
    iterated = result.first or result
    if result.stop_reason == "iteration limit" and stands_still(iterated.history):
        return "iteration limit; the picture hardly changes any more"
    return result.stop_reason


def resolved_frequency(problem: Problem, scene: Tensor, psf: Tensor, noise: float) -> float:
    r"""Highest spatial frequency at which bars are seen above the noise, in cycles per pixel.

    Bars of 10 % contrast, a cosine of amplitude 0.1 v̄ over a square of 3 periods, have the energy
    :math:`(0.1\,v̄)^2 (3/f)^2 / 2` for a scene of mean radiance v̄. Through a PSF of transfer H they
    keep the fraction :math:`|H(f)|^2`. What detects them best in white noise σ has the root of
    energy over σ² as its signal-to-noise ratio, and they are seen where that is 5 (`rose1948`):

    .. math:: \frac{0.1\,v̄\,|H(f)|}{\sqrt{2}\,σ}\,\frac{3}{f} ≥ 5.

    |H|² is the mean over a ring of equal frequency, v̄ the mean weighted by radiance, so that dark
    surroundings do not count, and channels are weighted by their power in the measurement. A PSF
    with noise of its own carries nothing beyond its `finest_detail`. Artefacts of a PSF that is not
    quite the camera's are not in it.

    Parameters
    ----------
    problem
        That was solved.
    scene
        In units of measurement over PSF.
    psf
        (channels, height, width), as it was used.
    noise
        Standard deviation of a pixel's noise in normalised units, of all channels (`pixel_noise`).

    Returns
    -------
    float
        Up to 0.5; 0 where no bars are seen.
    """
    rows, columns = problem.forward.geometry.padded
    down, right = torch.fft.fftfreq(rows)[:, None], torch.fft.rfftfreq(columns)
    rings = min(_RINGS, min(rows, columns) // 4)
    ring = (torch.hypot(down, right) * (rings / _NYQUIST)).int().clamp_(max=rings).flatten()
    count = torch.bincount(ring, minlength=rings + 1)[:rings].clamp_min(1)
    frequency = (torch.arange(rings) + 1) * (_NYQUIST / rings)
    power = (problem.scale * problem.psf_norm).double().square().flatten().cpu()
    ratio = torch.zeros(rings, dtype=torch.float64)
    for channel, weight in enumerate(power / power.sum()):
        light = (scene[channel] / problem.scale[channel]).double()
        mean = float(light.square().sum() / light.sum())
        spectrum = problem.transfer(channel).abs().square().flatten().double().cpu()
        transfer = torch.bincount(ring, spectrum, rings + 1)[:rings] / count
        ratio += weight * (_CONTRAST * mean * _PERIODS / frequency).square() * transfer / 2
    visible = (ratio.sqrt() >= _VISIBLE * noise).nonzero()
    return min(float(frequency[visible[-1]]), finest_detail(psf)) if len(visible) else 0.0
