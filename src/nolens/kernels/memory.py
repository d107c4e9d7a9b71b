"""Memory for the arrays of an iteration."""

import numpy as np
import torch
from torch import Tensor


def in_large_pages(tensor: Tensor) -> Tensor:
    """The same values in memory of numpy's, which asks the system for large pages.

    Transforms along columns touch a new page at every element; with small pages that costs more
    than the transform. Tensors on CUDA are handed back as they are.
    """
    if tensor.device.type != "cpu":
        return tensor
    array = np.empty(tensor.shape, dtype=tensor.numpy().dtype)
    array[...] = tensor.numpy()
    return torch.from_numpy(array)
