"""Any objective Σ fᵢ(Kᵢv), by the solver that suits it."""

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from nolens.kernels import irfft2
from nolens.operators import CroppedConvolution
from nolens.solvers.admm import admm
from nolens.solvers.data_terms import Gaussian
from nolens.solvers.functionals import L1, Functional, NonNegative, TotalVariation, Weighted
from nolens.solvers.objective import objective
from nolens.solvers.problem import Prior, Problem
from nolens.solvers.result import Callback, Progress, Result
from nolens.solvers.split_admm import split_admm


def minimise(
    *functionals: Functional,
    start: Tensor | None = None,
    iterations: int = 1000,
    tolerance: float = 1e-5,
    callback: Callback | None = None,
) -> Result:
    r"""Minimise Σ fᵢ(Kᵢv) over scenes v.

    The objective of eq. 7 (`uvimprint`) in float32, a `CroppedConvolution` with a `Gaussian` of
    equal weights, non-negativity, and total variation (zero around a support, periodic without
    one), ℓ1 or nothing, goes to `admm`, whose iterations are fused. Every other goes to
    `split_admm`; call `primal_dual` and `proximal_gradient` for theirs.

    Parameters
    ----------
    functionals
        Such as ``Gaussian(b) @ A``, ``0.01 * TotalVariation(A.domain_shape)``, ``NonNegative()``.
    start
        Scene to start from, for `split_admm`; None for zero, or a uniform one.
    iterations
        Limit, ≥ 1.
    tolerance
        Stops when all relative residuals are at most that. 0 never stops for it.
    callback
        Called at every convergence check; stops the run by returning True.

    Returns
    -------
    Result
        Scene, objective and history in the units of the functionals.

    Raises
    ------
    OptionError
        If a parameter lies outside its range, or there is neither a data term nor a start.
    DivergenceError
        If an iterate is NaN or infinite.
    """
    fused = _Fused.of(functionals) if start is None else None
    if fused is None:
        return split_admm(
            *functionals,
            start=start,
            iterations=iterations,
            tolerance=tolerance,
            callback=callback,
        )
    return fused.solve(functionals, iterations, tolerance, callback)


@dataclass(frozen=True)
class _Fused:
    """An objective that is `unit` times that of a normalised problem."""

    problem: Problem
    unit: float

    @classmethod
    def of(cls, functionals: Sequence[Functional]) -> "_Fused | None":
        """None where the objective is another."""
        fits: list[tuple[float, Gaussian, CroppedConvolution]] = []
        priors: list[tuple[float, TotalVariation | L1]] = []
        non_negative = False
        for each in functionals:
            (weight, base), (scale, inner) = (_unweighted(f) for f in (each, each.parts.functional))
            operator = each.parts.operator
            if isinstance(base, NonNegative):
                non_negative = True
            elif isinstance(base, TotalVariation | L1):
                priors.append((weight, base))
            elif isinstance(inner, Gaussian) and type(operator) is CroppedConvolution:
                fits.append((scale, inner, operator))
            else:
                return None
        if len(fits) != 1 or len(priors) > 1 or not non_negative:
            return None
        ((scale, gaussian, forward),) = fits
        tau, prior = priors[0] if priors else (0.0, None)
        kind = _prior_of(prior, forward)
        data, valid, w = gaussian.data, gaussian.weights > 0, float(gaussian.weights.max())
        norm = float(torch.linalg.vector_norm(data.double()))
        equal = bool((valid == (gaussian.weights == w)).all())
        alike = data.ndim == 2 or (data.ndim == 3 and forward.channels in (1, len(data)))
        if kind is None or not (equal and alike and data.dtype == torch.float32 and scale * norm):
            return None
        channels = 1 if data.ndim == 2 else len(data)
        energy = irfft2(forward.power.to(forward.transfer.dtype), forward.geometry.padded)
        psf_norm, norm = float(energy[:, 0, 0].mean()) ** 0.5, norm / channels**0.5
        normalised = copy(forward)
        normalised.transfer = forward.transfer / psf_norm
        ones = data.new_ones((channels, 1, 1))
        problem = Problem(
            forward=normalised,
            data=data.reshape(channels, *data.shape[-2:]) / norm,
            valid=valid.reshape(channels, *data.shape[-2:]),
            tau=tau / (scale * w * norm * psf_norm),
            prior=kind,
            scale=ones * (norm / psf_norm),
            psf_norm=ones * psf_norm,
        )
        return cls(problem, scale * w * norm**2 * channels)

    def solve(
        self,
        functionals: Sequence[Functional],
        iterations: int,
        tolerance: float,
        callback: Callback | None,
    ) -> Result:
        """By `admm`, in the units of the functionals."""

        def seen(progress: Progress) -> bool | None:
            assert callback is not None
            scene = progress.scene
            return callback(
                replace(
                    progress,
                    objective=self.unit * progress.objective,
                    scene=lambda: self.problem.unscale(scene()),
                )
            )

        result = admm(
            self.problem,
            iterations=iterations,
            tolerance=tolerance,
            low_frequency=True,
            callback=None if callback is None else seen,
        )
        return replace(
            result,
            objective=objective(functionals, result.scene),
            frame=(0, 0, *result.scene.shape[-2:]),
            history=[{**row, "objective": self.unit * row["objective"]} for row in result.history],
        )


def _prior_of(prior: TotalVariation | L1 | None, forward: CroppedConvolution) -> Prior | None:
    """That of eq. 7; None where the variation has another border or other axes."""
    if prior is None:
        return Prior.NONE
    if isinstance(prior, L1):
        return Prior.L1
    scene, padded = forward.geometry.scene[2:], forward.geometry.padded
    around = [n < m for n, m in zip(scene, padded, strict=True)]
    border = "zero" if all(around) else None if any(around) else "periodic"
    if prior.border != border or prior.operator.domain_shape != scene:
        return None
    return Prior.ISOTROPIC_TV if prior.isotropic else Prior.TV


def _unweighted(functional: Functional) -> tuple[float, Functional]:
    weight = 1.0
    while isinstance(functional, Weighted):
        weight, functional = weight * functional.weight, functional.functional
    return weight, functional
