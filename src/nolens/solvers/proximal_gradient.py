"""Accelerated proximal gradient (FISTA) with restart, for any smooth data term."""

import math
from collections.abc import Iterator, Sequence
from functools import partial

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.solvers.functionals import Functional, ProximalSum, Term, length
from nolens.solvers.objective import energy, first_scene, objective, ratio, solve
from nolens.solvers.result import Callback, Progress, Result

_INNER = 10
"""Steps of the dual iteration in each proximal map; warm-started, a few are enough."""
_GROWTH = 2.0
"""Factor on the curvature where a step was too long."""


def proximal_gradient(
    *functionals: Functional,
    start: Tensor | None = None,
    lipschitz: float | None = None,
    restart: bool = True,
    iterations: int = 1000,
    tolerance: float = 1e-5,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise h(v) + g(v) by accelerated proximal gradient (`beck2009`).

    h is the sum of the functionals with a gradient, g that of the others:
    v ← prox_{g/L}(y − ∇h(y)/L), y ← v + β(v − v_before) with Nesterov's momentum, which begins anew
    where it points uphill (`odonoghue2015`). Where g has operators or more than one term its
    proximal map is solved for in the dual (`ProximalSum`).

    Parameters
    ----------
    functionals
        One with a gradient at least, such as ``Gaussian(b) @ A``.
    start
        Scene to start from; None for zero, or a uniform one where that is infinite.
    lipschitz
        L, of the gradient of h; None computes it by power iteration, and finds it by
        backtracking where there is no bound (`Poisson` without a background).
    restart
        Whether the momentum may begin anew.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when ‖v − v_before‖ ≤ tolerance · ‖v‖. 0 runs to the limit.
    callback
        Called after every iteration; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range, or no functional has a gradient.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    smooth = [each.parts for each in functionals if each.parts.functional.lipschitz is not None]
    others = [each for each in functionals if each.parts.functional.lipschitz is None]
    if not smooth:
        raise OptionError("no functional has a gradient: give one, such as Gaussian(b) @ A")
    v = first_scene(functionals) if start is None else start
    bounds = [(term.functional.lipschitz or 0.0) for term in smooth]
    backtracking = lipschitz is None and math.inf in bounds
    if backtracking:
        lipschitz = energy(smooth, v)
    elif lipschitz is None:
        pairs = zip(bounds, smooth, strict=True)
        lipschitz = sum(bound * term.squared_norm(v) for bound, term in pairs)
    run = ProximalGradientRun(
        smooth, others, v, lipschitz, restart=restart, backtracking=backtracking
    )
    return solve(
        run.steps(iterations),
        partial(objective, functionals),
        iterations=iterations,
        tolerance=tolerance,
        callback=callback,
    )


class ProximalGradientRun:
    """The iterate v, the point y ahead of it, and the images of both by every smooth term."""

    def __init__(
        self,
        smooth: Sequence[Term],
        others: Sequence[Functional],
        v: Tensor,
        lipschitz: float,
        *,
        restart: bool,
        backtracking: bool,
    ) -> None:
        self._smooth, self._others = smooth, others
        self._proximal = ProximalSum(others, iterations=_INNER)
        self._restart, self._backtracking = restart, backtracking
        self._lipschitz, self._momentum = lipschitz, 1.0
        self._v = self._y = v
        self._images = self._images_ahead = [term.image(v) for term in smooth]

    def steps(self, limit: int) -> Iterator[Progress]:
        """Iterate to the limit."""
        return (self._step(iteration) for iteration in range(1, limit + 1))

    def _step(self, iteration: int) -> Progress:
        before, images_before = self._v, self._images
        if self._backtracking and not math.isfinite(self._height(self._images_ahead)):
            self._y, self._images_ahead, self._momentum = before, images_before, 1.0
        slope = torch.zeros_like(before)
        for term, image in zip(self._smooth, self._images_ahead, strict=True):
            slope = slope + term.back(term.functional.gradient(image))
        while True:
            v = self._proximal(self._y - slope / self._lipschitz, 1 / self._lipschitz)
            images = [term.image(v) for term in self._smooth]
            if not self._backtracking or self._is_below(v, slope, images):
                break
            self._lipschitz *= _GROWTH
        self._v, self._images = v, images
        if self._restart and float(((self._y - v) * (v - before)).sum()) > 0:
            self._momentum = 1.0
        following = (1 + math.sqrt(1 + 4 * self._momentum**2)) / 2
        factor, self._momentum = (self._momentum - 1) / following, following
        self._y = v + factor * (v - before)
        self._images_ahead = [
            image + factor * (image - earlier)
            for image, earlier in zip(images, images_before, strict=True)
        ]
        moved = ratio(length(v - before), length(v))
        others = [float(each(v)) for each in self._others]
        return Progress(
            iteration=iteration,
            objective=self._height(images) + sum(each for each in others if each != math.inf),
            primal_residual=0.0,
            dual_residual=moved,
            scene_change=moved,
            penalties=(self._lipschitz,),
            scene=lambda: v,
        )

    def _height(self, images: Sequence[Tensor]) -> float:
        """h, from its images."""
        pairs = zip(self._smooth, images, strict=True)
        return sum(float(term.functional(image)) for term, image in pairs)

    def _is_below(self, v: Tensor, slope: Tensor, images: Sequence[Tensor]) -> bool:
        """Whether h(v) is below the parabola at y that the step assumes."""
        moved = v - self._y
        rise = float((slope * moved).sum() + 0.5 * self._lipschitz * moved.square().sum())
        height = self._height(self._images_ahead)
        return self._height(images) <= height + rise + 1e-7 * abs(height)
