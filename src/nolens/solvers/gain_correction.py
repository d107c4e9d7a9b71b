"""The gain of a scene, which ADMM is slowest at where it fills the view."""

import torch
from torch import Tensor

from nolens.solvers.problem import Problem


def gain_corrected(problem: Problem, scene: Tensor) -> tuple[Tensor, float]:
    """Every channel times the factor f that minimises the objective, and the objective.

    The iterate's mean is held by all pixels that it lights, and comes to rest last: it can
    be some per cent off, each channel in its own way, when the picture has long been there. As all
    priors are homogeneous, R(fv) = f R(v), the best factor is f = (⟨b, CMv⟩ − τR(v)) / ‖CMv‖²
    where that is above zero.

    Parameters
    ----------
    problem
        In normalised units.
    scene
        `(channels, height, width)` in normalised units, non-negative.
    """
    fit = torch.where(problem.valid, problem.data - problem.residual(scene), 0).double()
    priors = [problem.tau * problem.regulariser(channel[None]) for channel in scene]
    prior = torch.stack(priors)
    power = fit.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    factor = ((fit * problem.data).sum(dim=(-2, -1)) - prior) / power
    if not bool((factor > 0).all()):
        factor = torch.ones_like(factor)
    residual = (problem.data - factor[:, None, None] * fit).square().sum(dim=(-2, -1))
    objective = float((0.5 * residual + factor * prior).mean())
    return factor.to(scene.dtype)[:, None, None] * scene, objective
