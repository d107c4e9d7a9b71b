"""Arguments of a solver, from the forms that a person gives them in to what it computes with.

In a notebook data are NumPy arrays as often as tensors, and words as often as members of an enum.
Everything is turned into what the solvers take, or refused with what would be accepted.
"""

import math
from enum import StrEnum
from typing import Any, TypeVar

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.operators import PixelRectangle

Plane = Tensor | ArrayLike
"""(channels, height, width) or (height, width), as a tensor or what NumPy makes an array of."""
Support = PixelRectangle | tuple[int, int] | tuple[int, int, int, int]
"""A support, (height, width) around the sensor's middle, or (top, left, height, width)."""

_Choice = TypeVar("_Choice", bound=StrEnum)
_MOST_CHANNELS = 8
"""Channels that a last axis may have for an array to be taken for a picture with them last."""


def one_of(choices: type[_Choice], value: Any, name: str) -> _Choice:
    """Member of an enum, from itself or its text; `name` is the parameter's, for the message.

    Raises
    ------
    OptionError
        If it is none of them.
    """
    try:
        return choices(value)
    except ValueError:
        known = ", ".join(choices)
        raise OptionError(f"{name} is {value!r}; give one of {known}") from None


def tensor_of(values: Plane, what: str) -> Tensor:
    """A tensor as it is, or one of what NumPy makes an array of; floats become float32.

    `what` is for the message, such as "PSF".

    Raises
    ------
    DataError
        If it is no array of numbers.
    """
    if isinstance(values, Tensor):
        return values
    try:
        array = np.asarray(values)
        if np.issubdtype(array.dtype, np.floating):
            array = array.astype(np.float32)
        # A copy: torch takes no negative strides, and nothing that cannot be written to.
        return torch.from_numpy(np.array(array, order="C"))
    except (TypeError, ValueError):
        raise DataError(
            f"the {what} is {type(values).__name__}; give a tensor or an array of numbers, "
            "(channels, height, width)"
        ) from None


def channels_of(values: Plane, what: str) -> Tensor:
    """Floating point values as (channels, height, width), without a gradient.

    NumPy's become float32; tensors keep their precision, but for less than float32. `what` is for
    the message, such as "PSF".

    Raises
    ------
    DataError
        If they are no floating point numbers, or have other axes.
    """
    # No gradient goes through a solver: what comes out does not ask for one.
    tensor = tensor_of(values, what).detach()
    if not tensor.is_floating_point():
        raise DataError(
            f"the {what} holds {_type(tensor)} and must be floating point: subtract the black "
            "level, and give float32"
        )
    if tensor.dtype not in (torch.float32, torch.float64):
        tensor = tensor.float()
    return _with_channels(tensor, what)


def mask_of(valid: Plane | None, data: Tensor) -> Tensor:
    """Pixels that take part in the fit, as bool of the data's shape; all without a mask.

    Raises
    ------
    DataError
        If the mask has another shape, or is not bool.
    """
    if valid is None:
        return torch.ones_like(data, dtype=torch.bool)
    mask = tensor_of(valid, "mask of valid pixels")
    if mask.dtype == torch.bool and mask.ndim == 2:
        mask = mask[None]
    if mask.shape != data.shape or mask.dtype != torch.bool:
        raise DataError(
            f"the mask of valid pixels is {tuple(mask.shape)} of {_type(mask)}; it must have the "
            f"measurement's shape, {tuple(data.shape)}, and be bool"
        )
    return mask


def support_of(support: Support | None, sensor: tuple[int, int]) -> PixelRectangle | None:
    """Support from itself or from whole numbers.

    Parameters
    ----------
    support
        The support in any of the accepted forms; None for no limit.
    sensor
        (height, width) of the measurement.

    Raises
    ------
    OptionError
        If it is neither.
    """
    if support is None or isinstance(support, PixelRectangle):
        return support
    try:
        sides = tuple(int(each) for each in support)
        whole = all(side == each for side, each in zip(sides, support, strict=True))
    except (TypeError, ValueError):
        sides, whole = (), False
    if not whole or len(sides) not in (2, 4):
        raise OptionError(
            f"support is {support!r}; give (height, width) in pixels around the sensor's middle, "
            "(top, left, height, width), or None for no limit"
        )
    if len(sides) == 2:
        return PixelRectangle.centred(sides[0], sides[1], sensor)
    return PixelRectangle(*sides)


def weight_of(tau: Any) -> float:
    """Weight of the prior as a finite number that is not negative.

    Raises
    ------
    OptionError
        If it is none.
    """
    try:
        value = float(tau)
    except (TypeError, ValueError):
        value = math.nan
    if not (value >= 0 and math.isfinite(value)):
        raise OptionError(f"tau is {tau!r}; it weighs the prior and must be a number, 0 or more")
    return value


def _with_channels(tensor: Tensor, what: str) -> Tensor:
    if tensor.ndim == 2:
        return tensor[None]
    shape = tuple(tensor.shape)
    if tensor.ndim != 3 or 0 in shape:
        raise DataError(f"the {what} must be (channels, height, width), and is {shape}")
    if shape[2] <= _MOST_CHANNELS < shape[0]:
        raise DataError(
            f"the {what} is {shape}, which looks like (height, width, channels): channels come "
            "first. Give x.permute(2, 0, 1) of a tensor, x.transpose(2, 0, 1) of an array"
        )
    return tensor


def _type(tensor: Tensor) -> str:
    return str(tensor.dtype).removeprefix("torch.")
