"""ADMM with a split for every term and any operator; conjugate gradients in its linear step."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import torch
from torch import Tensor

from nolens.errors import OptionError
from nolens.solvers.admm_state import CHECK_EVERY, Balance
from nolens.solvers.functionals import Functional, length, terms_of
from nolens.solvers.objective import energy, first_scene, objective, ratio, solve
from nolens.solvers.result import Callback, Progress, Result

_START = 0.5
"""Penalties to start with, over the energy that the data terms keep of white noise."""
_CONVEX = 2.0
"""Penalty at least, over the concavity of a functional that is not convex."""
_CLOSER = 0.1
"""Factor by which conjugate gradients reduce what the last iteration left, if the limit allows."""
_TINY = 1e-30

LinearStep = Callable[[Tensor, Tensor, Sequence[float]], Tensor]


def split_admm(
    *functionals: Functional,
    start: Tensor | None = None,
    penalties: Sequence[float] | None = None,
    balance: Balance | None = Balance(),  # noqa: B008 (frozen)
    relaxation: float = 1.5,
    inner: int = 20,
    linear_step: LinearStep | None = None,
    iterations: int = 1000,
    tolerance: float = 1e-5,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise Σ fᵢ(Kᵢv) by ADMM, zᵢ = Kᵢv for every term (`combettes2011`, `boyd2011`).

    Terms ½‖W^½(Kv − b)‖² stay in the linear step,

    .. math:: \Big(\sum_q K_q^* W_q K_q + \sum_i μ_i K_i^* K_i\Big) v
       = \sum_q K_q^* W_q b_q + \sum_i μ_i K_i^* (z_i - d_i),

    which conjugate gradients solve from the scene before, each time ten times as closely as the
    scene before does (inexact ADMM, `eckstein2017`). The others are split, each with its
    proximal map.

    Parameters
    ----------
    functionals
        Of the objective.
    start
        Scene to start from; None for zero, or a uniform one where that is infinite.
    penalties
        μᵢ > 0 of the terms that are split, in their order; constraints on pixels, with the ℓ1 norm,
        are one term, the last. None leaves the choice to the program.
    balance
        How the penalties are balanced as it runs; None keeps them, as denoisers do.
    relaxation
        α in (0, 2).
    inner
        Steps of conjugate gradients in an iteration, at most.
    linear_step
        What solves the linear step in their place: from the scene before, the right side and the
        penalties to a scene.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when, for every split, ‖Kv − z‖ ≤ tolerance · ‖z‖ (primal) and
        ‖z − z_before‖ ≤ tolerance · ‖z‖ (dual). 0 never stops for it.
    callback
        Called after every fourth iteration, and the last; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    v = first_scene(functionals) if start is None else start
    run = _Run(functionals, v, penalties, relaxation, inner, linear_step)
    return solve(
        run.checks(iterations, balance),
        partial(objective, functionals),
        iterations=iterations,
        tolerance=tolerance,
        callback=callback,
    )


class _Run:
    """The scene v, and for each split its a = z + d, where z is the proximal map at a."""

    def __init__(
        self,
        functionals: Sequence[Functional],
        v: Tensor,
        penalties: Sequence[float] | None,
        relaxation: float,
        inner: int,
        linear_step: LinearStep | None,
    ) -> None:
        if not 0 < relaxation < 2 or inner < 1:
            raise OptionError(
                f"relaxation is {relaxation:g} and inner {inner}; they must lie between 0 and 2, "
                "and be 1 or more"
            )
        terms = terms_of(functionals)
        self._fitted = [term for term in terms if term.functional.hessian is not None]
        self._split = [term for term in terms if term.functional.hessian is None]
        self._v, self._relaxation, self._inner = v, relaxation, inner
        self._target = torch.zeros_like(v)
        for term in self._fitted:
            at_zero = term.functional.gradient(torch.zeros_like(term.image(v)))
            self._target = self._target - term.back(at_zero)
        self._mu = self._first_penalties() if penalties is None else list(penalties)
        if len(self._mu) != len(self._split) or not all(0 < mu < math.inf for mu in self._mu):
            raise OptionError(
                f"penalties are {self._mu}; give one above 0 for each of the {len(self._split)} "
                "functionals that are not quadratic"
            )
        self._a = [term.image(v) for term in self._split]
        self._linear_step = linear_step or self._solve

    def checks(self, iterations: int, balance: Balance | None) -> Iterator[Progress]:
        """Iterate to the limit."""
        for iteration in range(1, iterations + 1):
            z_before, a_before, v_before = self._z(), self._a, self._v
            images = self._iterate(z_before)
            if iteration % CHECK_EVERY and iteration < iterations:
                continue
            z = self._z()
            sizes = [length(each) for each in z]
            changes = [length(each - old) for each, old in zip(z, z_before, strict=True)]
            apart = [length(image - each) for image, each in zip(images, z, strict=True)]
            turned = [
                length(a - new - earlier + old)
                for a, new, earlier, old in zip(self._a, z, a_before, z_before, strict=True)
            ]
            moved = ratio(length(self._v - v_before), length(self._v))
            scene = self._scene(z)
            yield Progress(
                iteration=iteration,
                objective=self._objective(z),
                primal_residual=max(map(ratio, apart, sizes), default=0.0),
                dual_residual=max(map(ratio, changes, sizes), default=moved),
                scene_change=moved,
                penalties=tuple(self._mu),
                scene=lambda scene=scene: scene,  # type: ignore[misc]
            )
            if balance is not None and not any(t.functional.keeps_penalty for t in self._split):
                turns, moves = ([each**2 for each in norms] for norms in (turned, changes))
                balanced = balance.balanced(self._mu, turns, moves, iteration)
                self._weigh(self._convex(balanced), z)

    def _first_penalties(self) -> list[float]:
        """Of a data term its curvature, of others a fraction of what all data terms keep."""
        fraction = _START * energy([*self._fitted, *self._split], self._v)
        return self._convex([term.functional.curvature or fraction for term in self._split])

    def _convex(self, penalties: Sequence[float]) -> list[float]:
        """Large enough for every proximal map to have one minimiser."""
        return [
            max(mu, _CONVEX * term.functional.concavity)
            for mu, term in zip(penalties, self._split, strict=True)
        ]

    def _z(self) -> list[Tensor]:
        return [
            term.functional.prox(a, 1 / mu)
            for term, a, mu in zip(self._split, self._a, self._mu, strict=True)
        ]

    def _iterate(self, z: list[Tensor]) -> list[Tensor]:
        """One iteration; the images of v."""
        target = self._target
        for term, new, a, mu in zip(self._split, z, self._a, self._mu, strict=True):
            target = target + mu * term.back(2 * new - a)
        self._v = self._linear_step(self._v, target, self._mu)
        images = [term.image(self._v) for term in self._split]
        self._a = [
            a + self._relaxation * (image - new)
            for a, image, new in zip(self._a, images, z, strict=True)
        ]
        return images

    def _solve(self, v: Tensor, target: Tensor, _penalties: Sequence[float]) -> Tensor:
        """Conjugate gradients from the scene before."""
        left = target - self._matrix(v)
        direction, size = left, float(left.square().sum())
        enough = _CLOSER**2 * size
        for _ in range(self._inner):
            if size <= max(enough, _TINY):
                break
            image = self._matrix(direction)
            step = size / max(float((direction * image).sum()), _TINY)
            v, left = v + step * direction, left - step * image
            before, size = size, float(left.square().sum())
            direction = left + (size / before) * direction
        return v

    def _matrix(self, v: Tensor) -> Tensor:
        out = torch.zeros_like(v)
        for term in self._fitted:
            assert term.functional.hessian is not None
            out = out + term.back(term.functional.hessian * term.image(v))
        for term, mu in zip(self._split, self._mu, strict=True):
            out = out + mu * term.back(term.image(v))
        return out

    def _weigh(self, penalties: list[float], z: list[Tensor]) -> None:
        """Go on with other penalties; splits and multipliers μd stay."""
        self._a = [
            torch.lerp(new, a, before / after)
            for new, a, before, after in zip(z, self._a, self._mu, penalties, strict=True)
        ]
        self._mu = penalties

    def _scene(self, z: list[Tensor]) -> Tensor:
        """The split of the first term without an operator: it is where its constraint holds."""
        plain = (new for term, new in zip(self._split, z, strict=True) if term.operator is None)
        return next(plain, self._v)

    def _objective(self, z: list[Tensor]) -> float:
        """Of v where terms stay with it, and of the splits."""
        fitted = sum(float(term.functional(term.image(self._v))) for term in self._fitted)
        pairs = zip(self._split, z, strict=True)
        return fitted + sum(float(term.functional(new)) for term, new in pairs)
