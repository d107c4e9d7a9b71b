"""How far a picture can be trusted: its spread under the noise, and where priors disagree."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.solvers.coarse import Errors
from nolens.solvers.problem import Problem
from nolens.solvers.reconstructor import Reconstructor
from nolens.solvers.result import Result

SAMPLES = 8
"""Where no other number is given."""
_FEWEST, _MOST = 2, 1000
_EXCESS = 1.5
"""Of fine detail over what is usual that is worth a warning: photographs have 0.4 to 0.8 of it."""
_COARSEST = 1 / 32
"""Spatial frequency from which on detail is judged where no bars are seen."""
_VISIBLE = 0.01
"""Root mean square of fine detail, over the mean, below which nobody sees it."""


@dataclass(frozen=True)
class Uncertainty:
    """What is not certain of a picture, in its units.

    Parameters
    ----------
    spread
        Standard deviation of each pixel over pictures of the same scene with other noise,
        (channels, height, width).
    samples
        Number of pictures that the spread is of.
    disagreement
        How far each pixel is from the picture by total variation, (channels, height, width); None
        where the picture is by that.
    """

    spread: Tensor = field(repr=False)
    samples: int
    disagreement: Tensor | None = field(default=None, repr=False)


def uncertainty(
    reconstructor: Reconstructor,
    problem: Problem,
    result: Result,
    samples: int = SAMPLES,
    *,
    seed: int = 0,
    progress: Callable[[float], bool | None] | None = None,
) -> Uncertainty | None:
    r"""Spread of a picture under the noise of its measurement, by a parametric bootstrap.

    The scene v̂ that came out is measured again, each time with other noise, and solved again in the
    same way, start and all (`efron1993`, ch. 6):

    .. math:: b_k = A\hat v + σ n_k, \qquad s = \operatorname{std}_k \hat v(b_k),

    with white noise of each channel's measured σ. It is what noise alone does to the picture.
    What the prior adds or leaves out each time in the same way, and errors of the PSF, are not in
    it: where two priors disagree tells of the former, and a picture by total variation is made for
    that where there is another prior.

    Parameters
    ----------
    reconstructor
        That solved the problem.
    problem, result
        What was solved, and what came of it.
    samples
        How many times, from 2 to 1000; each takes as long as the picture did.
    seed
        Of the noise.
    progress
        Called with the fraction that is done; stops by returning True.

    Returns
    -------
    Uncertainty
        None where it was stopped.

    Raises
    ------
    OptionError
        If the number of samples is out of range.
    """
    if not _FEWEST <= samples <= _MOST:
        raise OptionError(f"{samples} samples; give {_FEWEST} to {_MOST}")
    expected = torch.where(problem.valid, problem.forward(result.scene / problem.scale), 0)
    noise = Errors.of(problem, result.scene).noise[:, None, None]
    generator = torch.Generator().manual_seed(seed)
    total = torch.zeros_like(result.scene, dtype=torch.float64)
    squares = torch.zeros_like(total)
    for number in range(samples):
        drawn = torch.randn(problem.data.shape, generator=generator).to(problem.data)
        data = torch.where(problem.valid, expected + noise * drawn, 0)
        # The same units: only the noise is another.
        scene = reconstructor.solve(replace(problem, data=data)).scene - result.scene
        total += scene
        squares += scene.double().square()
        if progress is not None and progress((number + 1) / samples):
            return None
    variance = (squares - total.square() / samples) / (samples - 1)
    disagreement = None
    if result.first is not None:
        usual = replace(reconstructor, prior=problem.prior).solve(problem)
        disagreement = (result.scene - usual.scene).abs()
    return Uncertainty(variance.clamp_min(0).sqrt().to(result.scene), samples, disagreement)


def detail_warning(result: Result, frequency: float) -> str | None:
    r"""That a trained prior shows detail which the PSF does not carry; None where it does not.

    Pictures have power of about 1 / f² at the spatial frequency f (`field1987`). By that law, and
    by what the picture has in the octave below the highest frequency at which bars are seen above
    the noise (`resolved_frequency`), more than so much above it is the network's own.

    Parameters
    ----------
    result
        Of a trained prior, with the photograph that it started from; without one there is none.
    frequency
        In cycles per pixel; 0 where no bars are seen.
    """
    mean = float(result.scene.mean())
    if result.first is None or mean <= 0:
        return None
    fine, usual = _fine(result.scene, max(frequency, _COARSEST))
    if fine <= _EXCESS * usual or fine <= _VISIBLE * mean:
        return None
    return (
        f"the picture holds {fine / max(usual, 1e-30):.2g} times as much detail as pictures have, "
        "finer than the PSF carries at this noise: the prior may have made it up. Compare with "
        "--prior tv"
    )


def _fine(scene: Tensor, frequency: float) -> tuple[float, float]:
    """Root mean square of what lies above a spatial frequency, and what the law 1 / f² expects."""
    height, width = scene.shape[-2:]
    down, right = torch.fft.fftfreq(height)[:, None], torch.fft.fftfreq(width)
    distance = torch.hypot(down, right).to(scene.device)
    power = torch.zeros_like(distance)
    for channel in scene:
        power += torch.fft.fft2(channel).abs().square()
    above = distance > frequency
    octave = (distance > frequency / 2) & ~above
    law = distance.clamp_min(1 / (height + width)).pow(-2)
    expected = law[above].sum() * power[octave].sum() / law[octave].sum().clamp_min(1e-30)
    values = scene.numel() * height * width
    return math.sqrt(float(power[above].sum()) / values), math.sqrt(float(expected) / values)
