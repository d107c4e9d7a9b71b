"""A physics of deepinv from an operator, and its denoisers as a prior (``nolens[deepinv]``)."""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from torch import Tensor

from nolens.errors import OptionError
from nolens.operators import LinearOperator
from nolens.solvers.denoiser import Denoiser


def deepinv_physics(operator: LinearOperator, **settings: Any) -> Any:
    """A `deepinv.physics.LinearPhysics` of an operator, for deepinv's solvers and training.

    It takes tensors (batch, channels, height, width), and gradients go through it.

    Parameters
    ----------
    operator
        A, which takes (channels, height, width).
    settings
        For `LinearPhysics`, such as ``noise_model=deepinv.physics.GaussianNoise(0.01)``.

    Raises
    ------
    OptionError
        If deepinv is not installed.
    """
    # deepinv hands all parameters of a physics to both; an operator has none.
    return _deepinv("physics").LinearPhysics(
        A=lambda x, **_: operator(x), A_adjoint=lambda y, **_: operator.adjoint(y), **settings
    )


def deepinv_denoiser(
    model: Callable[[Tensor, float], Tensor], sigma: float | None = None, *, white: float = 1.0
) -> Denoiser:
    """A denoiser that takes (batch, channels, height, width) between 0 and 1, as deepinv's do.

    Parameters
    ----------
    model
        Such as ``deepinv.models.DRUNet()``.
    sigma
        σ in the scene's units; None for what the solver's step asks for.
    white
        Value of the scene that the model takes for 1.

    Raises
    ------
    OptionError
        If `white` is not above 0.
    """
    if not white > 0:
        raise OptionError(
            f"white is {white}; it must be above 0: about the scene's brightest value"
        )

    def denoise(v: Tensor, noise: float) -> Tensor:
        pictures = v.reshape(-1, *v.shape[-3:]) / white
        return white * model(pictures, noise / white).reshape(v.shape)

    return Denoiser(denoise, sigma)


def _deepinv(part: str) -> Any:
    try:
        return import_module(f"deepinv.{part}")
    except (
        ImportError,
        OSError,
        RuntimeError,
    ) as error:  # Or a torchvision that does not fit torch.
        raise OptionError(
            f"deepinv cannot be loaded ({error}): pip install 'nolens[deepinv]'"
        ) from None
