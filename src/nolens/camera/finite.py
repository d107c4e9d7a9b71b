"""Whether numbers can be computed with."""

import torch
from torch import Tensor


def all_finite(values: Tensor) -> bool:
    """Whether no value is NaN or infinite.

    A sum is finite only if its terms are, and costs a tenth of looking at each of them, which
    is left for sums that overflow.
    """
    return bool(torch.isfinite(values.sum())) or bool(torch.isfinite(values).all())
