"""The weights of the Wiener filters, chosen by pixels that are left out of the fit."""

from collections.abc import Callable
from dataclasses import replace

import torch
from torch import Tensor

from nolens.solvers.held_out import (
    Weight,
    excess_of,
    held_out_blocks,
    local_mean,
    pixel_noise,
    pixels_of,
    prediction_errors,
    weight_of_errors,
    without_blocks,
)
from nolens.solvers.problem import Problem
from nolens.solvers.wiener import LinearEstimate, circulant_wiener, wiener

_SQUARES_BY_NOISE, _SQUARES_FROM, _SQUARES_AT_MOST = 0.005, 8.0, 10
"""Weight of a scene's squared differences where only the noise is known, the first that is tried,
and how many: over the square of the noise of a pixel in normalised units and of their number."""
_RATIO = 4.0
"""Of neighbouring weights."""
_SOME, _HARDLY = 0.9, 1e-3
"""Of the contrast, what is left unexplained where a weight of squares explains some of it, and what
a weaker one has to explain more from there on: in next to no noise it is a little more and more."""
_CIRCULANT_WEIGHTS = tuple(3.0 * 0.3**step for step in range(8))
_CIRCULANT_FALLBACK = 0.3
"""Weights of the circulant filter, over the mean power of the PSF's transfer."""


def choose_wiener_weight(
    problem: Problem, progress: Callable[[float], bool | None] | None = None
) -> Weight:
    """The weight of the scene of smallest squares with which left-out pixels are predicted best.

    From a strong one they go down by factors of 4 until the prediction is worse, or hardly better;
    each scene starts from the one before it. What a weak one has learnt of the noise it would not
    forget as quickly.

    Parameters
    ----------
    problem
        Whose weight does not matter.
    progress
        Called with the fraction that is done; stops by returning True.
    """
    noise = pixel_noise(problem)
    of_noise = _squared(noise, problem)
    by_noise = Weight(_SQUARES_BY_NOISE * of_noise / problem.tau_unit, noise)
    blocks = held_out_blocks(problem.valid)
    if blocks is None:
        return by_noise
    held, fitted = without_blocks(problem, blocks)
    estimate = LinearEstimate(fitted)
    dark = prediction_errors(problem, problem.data.new_zeros(problem.scene_shape), held, blocks)
    contrast = float(dark.mean())
    errors: dict[float, Tensor] = {}
    least = contrast
    for number in range(_SQUARES_AT_MOST):
        if progress is not None and progress(number / _SQUARES_AT_MOST):
            return replace(by_noise, interrupted=True)
        tau = _SQUARES_FROM * of_noise / _RATIO**number
        estimate.solve(tau)
        errors[tau] = prediction_errors(problem, estimate.scene, held, blocks)
        gained = least - float(errors[tau].mean())
        excess, error = excess_of(errors[tau], min(errors.values(), key=lambda each: each.sum()))
        if excess > error or (least < _SOME * contrast and gained < _HARDLY * contrast):
            break
        least = min(least, float(errors[tau].mean()))
    return weight_of_errors(problem, errors, noise, held, blocks)


def likely_scene(problem: Problem) -> Tensor:
    """The scene of smallest squares that the noise asks for, in normalised units, at once.

    Parameters
    ----------
    problem
        Whose prior and weight do not matter.
    """
    tau = _SQUARES_BY_NOISE * _squared(pixel_noise(problem), problem)
    return wiener(replace(problem, tau=tau)).scene / problem.scale


def _squared(noise: float, problem: Problem) -> float:
    """Of a pixel's noise and the number of pixels, what weights of squares are in parts of."""
    return (noise * problem.data[0].numel()) ** 2


def choose_circulant_weight(problem: Problem) -> Weight:
    """As `choose_wiener_weight`, for `circulant_wiener`.

    That takes a pixel that is not valid for dark; here left-out ones are the local mean of those
    around them.

    Parameters
    ----------
    problem
        Whose weight does not matter.
    """
    noise = pixel_noise(problem)
    blocks = held_out_blocks(problem.valid)
    if blocks is None:
        return Weight(_CIRCULANT_FALLBACK / problem.tau_unit, noise)
    held = pixels_of(blocks, problem.forward.sensor).to(problem.data.device)
    around = local_mean(problem.data, problem.valid & ~held)
    fitted = replace(problem, data=torch.where(held, around, problem.data))
    errors: dict[float, Tensor] = {}
    for tau in _CIRCULANT_WEIGHTS:
        scene = circulant_wiener(replace(fitted, tau=tau)).scene / problem.scale
        errors[tau] = prediction_errors(problem, scene, held, blocks)
    return weight_of_errors(problem, errors, noise, held, blocks)
