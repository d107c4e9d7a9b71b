"""Whether numbers can be computed with."""

import math

import torch
from torch import Tensor

LARGEST = 1e15
"""Beyond this, and below its inverse, sums of squares leave the range of float32."""


def unusable(values: Tensor) -> str | None:
    """Why values cannot be computed with, as the end of a sentence; None where they can.

    Parameters
    ----------
    values
        Of a file, any shape. Zeros are no reason.
    """
    low, high = (float(each) for each in values.aminmax())
    largest = max(abs(low), abs(high))
    if not math.isfinite(largest):
        count = int((~torch.isfinite(values)).sum())
        return (
            f"{count} values that are NaN or infinite, of {values.numel()}: repair them before, "
            "for example by the mean of their neighbours"
        )
    if largest > LARGEST or 0 < largest < 1 / LARGEST:
        return (
            f"values up to {largest:.3g}, and {1 / LARGEST:g} to {LARGEST:g} can be computed with: "
            "multiply them all by one number"
        )
    return None


def all_finite(values: Tensor) -> bool:
    """Whether no value is NaN or infinite.

    A sum is finite only if its terms are, and costs a tenth of looking at each of them, which
    is left for sums that overflow.
    """
    return bool(torch.isfinite(values.sum())) or bool(torch.isfinite(values).all())
