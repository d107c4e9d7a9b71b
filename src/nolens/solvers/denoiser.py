"""Plug-and-play: any denoiser in place of a proximal map."""

from collections.abc import Callable

import torch
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.solvers.functionals import Functional

Denoise = Callable[[Tensor, float], Tensor]
"""A picture with noise of a standard deviation, to one without; of the same shape."""


class Denoiser(Functional):
    r"""A prior that is known by its denoiser alone (`venkatakrishnan2013`).

    The proximal map of a prior is the most probable picture under white noise of the variance
    `step`. Here a denoiser gives it, any function of the picture and the noise's standard
    deviation. There is no value: it counts as 0 in the objective. ``2.0 * Denoiser(…)`` takes the
    noise √2 times as strong. `split_admm` keeps its penalties with it.

    Parameters
    ----------
    denoise
        Called with the scene and σ.
    sigma
        σ in the scene's units, whatever the solver's step; None for √step.

    Raises
    ------
    OptionError
        If sigma is not above 0.
    """

    keeps_penalty = True

    def __init__(self, denoise: Denoise, sigma: float | None = None) -> None:
        if sigma is not None and not sigma > 0:
            raise OptionError(f"sigma is {sigma}; it must be above 0, or None for the solver's")
        self.denoise, self.sigma = denoise, sigma

    def _value(self, v: Tensor) -> Tensor:
        return v.new_zeros((), dtype=torch.float64)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """What the denoiser makes of v.

        Raises
        ------
        DataError
            If that has another shape.
        """
        with torch.no_grad():
            denoised = self.denoise(v, step**0.5 if self.sigma is None else self.sigma)
        if not isinstance(denoised, Tensor) or denoised.shape != v.shape:
            given = tuple(denoised.shape) if isinstance(denoised, Tensor) else type(denoised)
            raise DataError(
                f"the denoiser made {given} of a scene {tuple(v.shape)}; it must give a tensor of "
                "the same shape"
            )
        return denoised.to(v)
