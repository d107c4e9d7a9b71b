"""The primal-dual method of Condat and Vũ, without an inner iteration."""

from collections.abc import Iterator, Sequence
from functools import partial

import torch
from torch import Tensor

from nolens.solvers.admm_state import CHECK_EVERY
from nolens.solvers.functionals import Functional, Term, length, pop_plain, terms_of
from nolens.solvers.objective import energy, first_scene, objective, ratio, solve
from nolens.solvers.result import Callback, Progress, Result


def primal_dual(
    *functionals: Functional,
    start: Tensor | None = None,
    balance: float = 30.0,
    iterations: int = 1000,
    tolerance: float = 1e-5,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise h(v) + g(v) + Σ fᵢ(Kᵢv) by the method of `condat2013` and `vu2013`.

    h is the sum of the functionals whose gradient has a Lipschitz constant, g one without an
    operator, and each of the others has a dual variable,

    .. math:: v^+ = \operatorname{prox}_{τg}(v - τ(∇h(v) + \sum_i K_i^* p_i)), \qquad
       p_i^+ = \operatorname{prox}_{σ_i f_i^*}(p_i + σ_i K_i(2v^+ - v)),

    with 1/τ = L/2 + c, σᵢ = c / (m‖Kᵢ‖²) for m dual variables, and L the Lipschitz constant of ∇h.
    No linear system is solved: an iteration is one use of every operator and adjoint.

    Parameters
    ----------
    functionals
        Of the objective.
    start
        Scene to start from; None for zero, or a uniform one where that is infinite.
    balance
        c over what the data terms keep of white noise: a larger one takes shorter steps of v and
        longer ones of p.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when v and every p change by less than this fraction of them. 0 runs to the limit.
    callback
        Called after every fourth iteration; stops the run by returning True.

    Raises
    ------
    OptionError
        If a parameter lies outside its range.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    v = first_scene(functionals) if start is None else start
    terms = terms_of(functionals)
    smooth = [term for term in terms if _bound(term) is not None]
    rest = [term for term in terms if _bound(term) is None]
    proximal = pop_plain(rest)
    norms = [term.squared_norm(v) for term in rest]
    steep = sum((_bound(term) or 0.0) * term.squared_norm(v) for term in smooth)
    c = balance * energy(terms, v) if rest else 0.5 * steep
    run = _Run(smooth, proximal, rest, v, 1 / (steep / 2 + c), [c / (len(rest) * n) for n in norms])
    return solve(
        run.checks(functionals, iterations),
        partial(objective, functionals),
        iterations=iterations,
        tolerance=tolerance,
        callback=callback,
    )


def _bound(term: Term) -> float | None:
    """Lipschitz constant of a gradient that has one."""
    bound = term.functional.lipschitz
    return bound if bound is not None and bound < float("inf") else None


class _Run:
    def __init__(
        self,
        smooth: Sequence[Term],
        proximal: Functional | None,
        split: Sequence[Term],
        v: Tensor,
        step: float,
        dual_steps: Sequence[float],
    ) -> None:
        self._smooth, self._proximal, self._split = smooth, proximal, split
        self._v, self._step, self._dual_steps = v, step, dual_steps
        self._duals = [torch.zeros_like(term.image(v)) for term in split]

    def checks(self, functionals: Sequence[Functional], iterations: int) -> Iterator[Progress]:
        """Iterate to the limit."""
        for iteration in range(1, iterations + 1):
            before, duals_before = self._v, self._duals
            self._iterate()
            if iteration % CHECK_EVERY and iteration < iterations:
                continue
            v = self._v
            moved = ratio(length(v - before), length(v))
            turned = [
                ratio(length(p - earlier), length(p))
                for p, earlier in zip(self._duals, duals_before, strict=True)
            ]
            yield Progress(
                iteration=iteration,
                objective=objective(functionals, v),
                primal_residual=moved,
                dual_residual=max(turned, default=0.0),
                scene_change=moved,
                penalties=(self._step, *self._dual_steps),
                scene=lambda v=v: v,  # type: ignore[misc]
            )

    def _iterate(self) -> None:
        slope = torch.zeros_like(self._v)
        for term in self._smooth:
            slope = slope + term.back(term.functional.gradient(term.image(self._v)))
        for term, p in zip(self._split, self._duals, strict=True):
            slope = slope + term.back(p)
        v = self._v - self._step * slope
        v = v if self._proximal is None else self._proximal.prox(v, self._step)
        ahead = 2 * v - self._v
        self._v = v
        self._duals = [
            term.functional.conjugate_prox(p + s * term.image(ahead), s)
            for term, p, s in zip(self._split, self._duals, self._dual_steps, strict=True)
        ]
