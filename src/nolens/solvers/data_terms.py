"""Data terms: how far what a scene would measure is from what was measured."""

import math
from abc import abstractmethod

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.solvers.functionals import Functional
from nolens.solvers.inputs import Plane, tensor_of


class DataTerm(Functional):
    """Σ w ℓ(y) over the pixels of a measurement; ``Gaussian(b) @ A`` is that of a scene.

    Subclasses write ℓ, its derivative, and its proximal map for a step of each pixel.

    Parameters
    ----------
    data
        The measurement b of any shape, floating point.
    weights
        w ≥ 0 of each pixel, of a shape that broadcasts; None for 1.
    valid
        bool, so too: False where a pixel takes no part in the fit. It may hold NaN in the data.

    Raises
    ------
    DataError
        If shapes, types or values cannot be used.
    """

    separable = True

    def __init__(
        self, data: Plane, *, weights: Plane | None = None, valid: Plane | None = None
    ) -> None:
        values = tensor_of(data, "measurement").detach()
        if not values.is_floating_point():
            raise DataError(f"the measurement is {values.dtype}; give floating point data")
        self.weights = torch.ones_like(values)
        for name, factor in (("weights", weights), ("mask of valid pixels", valid)):
            if factor is not None:
                self.weights = self.weights * _alike(tensor_of(factor, name), values, name)
        self._data = torch.where(self.weights > 0, values, 0)
        if not bool(torch.isfinite(self._data).all() & (self.weights >= 0).all()):
            raise DataError(
                "the measurement holds NaN or infinity, or a weight is negative: mark such pixels "
                "as not valid"
            )

    @property
    def data(self) -> Tensor:
        """The measurement, 0 where it is not valid."""
        return self._data

    def _value(self, v: Tensor) -> Tensor:
        loss = torch.where(self.weights > 0, self.weights * self._loss(v), 0)
        return loss.sum(dtype=torch.float64)

    def gradient(self, v: Tensor) -> Tensor:
        """Of each pixel, w ℓ′."""
        return torch.where(self.weights > 0, self.weights * self._slope(v), 0)

    def prox(self, v: Tensor, step: float) -> Tensor:
        """That of each pixel; those that are not valid stay."""
        return torch.where(self.weights > 0, self._prox(v, step * self.weights), v)

    @abstractmethod
    def _loss(self, v: Tensor) -> Tensor: ...

    @abstractmethod
    def _slope(self, v: Tensor) -> Tensor: ...

    @abstractmethod
    def _prox(self, v: Tensor, steps: Tensor) -> Tensor: ...


class Gaussian(DataTerm):
    r"""½ Σ w (y − b)²: noise of the variance 1/w.

    Parameters
    ----------
    data, weights, valid
        As `DataTerm` takes them.
    """

    def __init__(
        self, data: Plane, *, weights: Plane | None = None, valid: Plane | None = None
    ) -> None:
        super().__init__(data, weights=weights, valid=valid)
        self.lipschitz = float(self.weights.max())

    @property
    def hessian(self) -> Tensor:
        """The weights."""
        return self.weights

    @property
    def curvature(self) -> float:
        """The mean weight."""
        return float(self.weights.mean())

    def _loss(self, v: Tensor) -> Tensor:
        return 0.5 * (v - self.data).square()

    def _slope(self, v: Tensor) -> Tensor:
        return v - self.data

    def _prox(self, v: Tensor, steps: Tensor) -> Tensor:
        return (v + steps * self.data) / (1 + steps)


class Poisson(DataTerm):
    r"""Σ w (t − b + b ln(b/t)), t = y + β: counts of a mean t (`harmany2012`).

    That is the negative log-likelihood less its least value, the Kullback-Leibler divergence. It is
    infinite where t < 0, or t = 0 < b. The proximal map is the positive root of
    t² + (s − v − β) t − s b = 0 with s = step · w.

    Parameters
    ----------
    data, weights, valid
        As `DataTerm` takes them; the data are counts, ≥ 0, with their background.
    background
        β: mean counts of what is not the scene, such as dark current; a number or of the data's
        shape.

    Raises
    ------
    DataError
        If a count or the background is negative.
    """

    lipschitz = math.inf

    def __init__(
        self,
        data: Plane,
        *,
        background: Tensor | float = 0.0,
        weights: Plane | None = None,
        valid: Plane | None = None,
    ) -> None:
        super().__init__(data, weights=weights, valid=valid)
        self.background = torch.as_tensor(
            background, dtype=self.data.dtype, device=self.data.device
        )
        least = float(self.data.min()), float(self.background.min())
        if not min(least) >= 0:
            raise DataError(
                f"the least count is {least[0]:g} and the least background {least[1]:g}; both must "
                "be 0 or more: give counts with their background, and the background beside them"
            )

    @property
    def curvature(self) -> float:
        """The mean weight over the mean count."""
        return float(self.weights.mean() / self.data.mean().clamp_min(1e-30))

    def _loss(self, v: Tensor) -> Tensor:
        t, b = v + self.background, self.data
        loss = t - b + torch.special.xlogy(b, b) - torch.special.xlogy(b, t)
        return torch.where(t >= 0, loss, math.inf)

    def _slope(self, v: Tensor) -> Tensor:
        t = v + self.background
        return 1 - torch.where(self.data > 0, self.data / t, 0)

    def _prox(self, v: Tensor, steps: Tensor) -> Tensor:
        half = 0.5 * (v + self.background - steps)
        root = torch.sqrt(half.square() + steps * self.data)
        # The sum of two numbers of one sign: nothing cancels.
        small = steps * self.data / (root - half).clamp_min(torch.finfo(v.dtype).tiny)
        return torch.where(half > 0, half + root, small) - self.background


def _alike(factor: Tensor, values: Tensor, name: str) -> Tensor:
    try:
        return torch.broadcast_to(factor.detach().to(values), values.shape)
    except RuntimeError:
        raise DataError(
            f"the {name} is {tuple(factor.shape)}, and the measurement {tuple(values.shape)}; "
            "give one of its shape, or of one that broadcasts to it"
        ) from None
