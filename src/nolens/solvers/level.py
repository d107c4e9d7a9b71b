"""The level of a scene that fills the view: what ADMM comes to last."""

import torch
from torch import Tensor

from nolens.solvers.problem import Problem


def levelled(problem: Problem, scene: Tensor) -> tuple[Tensor, float]:
    """Every channel times the factor f that minimises the objective, and the objective.

    The iterate's mean is held by all pixels that it is seen through, and comes to rest last: it can
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
    seen = torch.where(problem.valid, problem.data - problem.residual(scene), 0).double()
    priors = [problem.tau * problem.regulariser(channel[None]) for channel in scene]
    prior = torch.stack(priors)
    power = seen.square().sum(dim=(-2, -1)).clamp_min(1e-300)
    factor = ((seen * problem.data).sum(dim=(-2, -1)) - prior) / power
    if not bool((factor > 0).all()):
        factor = torch.ones_like(factor)
    misfit = (problem.data - factor[:, None, None] * seen).square().sum(dim=(-2, -1))
    objective = float((0.5 * misfit + factor * prior).mean())
    return factor.to(scene.dtype)[:, None, None] * scene, objective
