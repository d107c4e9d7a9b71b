"""Operators without a neighbourhood: identity, weights of pixels, a window of a larger array."""

from types import EllipsisType

from torch import Tensor

from nolens.operators.base import LinearOperator


class Identity(LinearOperator):
    """v itself.

    Parameters
    ----------
    shape
        Trailing axes.
    """

    def __init__(self, shape: tuple[int, ...]) -> None:
        self.shape = tuple(shape)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """The given axes."""
        return self.shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """The given axes."""
        return self.shape

    def _forward(self, v: Tensor) -> Tensor:
        return v.clone()

    def _adjoint(self, y: Tensor) -> Tensor:
        return y.clone()


class Diagonal(LinearOperator):
    """Every pixel times its own weight; bool weights make a mask.

    Parameters
    ----------
    weights
        Of the pixels, real or bool, of the shape that the operator takes; the result has the
        precision of what it is applied to.
    """

    def __init__(self, weights: Tensor) -> None:
        self.weights = weights

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Shape of the weights."""
        return tuple(self.weights.shape)

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Shape of the weights."""
        return tuple(self.weights.shape)

    def _forward(self, v: Tensor) -> Tensor:
        return v * self.weights.to(v)

    def _adjoint(self, y: Tensor) -> Tensor:
        return y * self.weights.to(y)


class Crop(LinearOperator):
    """A window of a larger array. Its adjoint, ``Crop(…).H``, pads with zeros.

    Parameters
    ----------
    shape
        (height, width) of the array, or more axes.
    window
        (top, left, height, width) within it: where it begins along each axis, and its sizes.

    Raises
    ------
    ValueError
        If the window reaches beyond the array.
    """

    def __init__(self, shape: tuple[int, ...], window: tuple[int, ...]) -> None:
        starts, sizes = window[: len(shape)], window[len(shape) :]
        if len(sizes) != len(shape) or not all(
            0 <= start <= start + size <= side
            for start, size, side in zip(starts, sizes, shape, strict=True)
        ):
            raise ValueError(
                f"the window {window} (top, left, height, width) reaches beyond an array of "
                f"{shape}; give one that lies within it"
            )
        self.shape, self._sizes = tuple(shape), tuple(sizes)
        parts = (slice(start, start + size) for start, size in zip(starts, sizes, strict=True))
        self._window: tuple[EllipsisType | slice, ...] = (..., *parts)

    @property
    def domain_shape(self) -> tuple[int, ...]:
        """Size of the array."""
        return self.shape

    @property
    def range_shape(self) -> tuple[int, ...]:
        """Size of the window."""
        return self._sizes

    def _forward(self, v: Tensor) -> Tensor:
        return v[self._window].clone()

    def _adjoint(self, y: Tensor) -> Tensor:
        padded = y.new_zeros((*y.shape[: y.ndim - len(self.shape)], *self.shape))
        padded[self._window] = y
        return padded
