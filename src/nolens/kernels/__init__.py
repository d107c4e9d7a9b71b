"""The hot loops: transforms and the fused passes of ADMM, one name each.

Behind every name stands one implementation for the CPU (scipy or ducc0, numba) and one for
CUDA (torch, Triton); callers hand over tensors and never choose.
"""

from nolens.kernels.admm import PassSums, SplitState, solve_normal_equation_, update_splits_
from nolens.kernels.fft import fast_length, fft2_, ifft2_, irfft2, rfft2
from nolens.kernels.memory import in_large_pages
from nolens.kernels.nearest import nearest_points
from nolens.kernels.repeat import Repeater
from nolens.kernels.transfer import apply_transfer_

__all__ = [
    "PassSums",
    "Repeater",
    "SplitState",
    "apply_transfer_",
    "fast_length",
    "fft2_",
    "ifft2_",
    "in_large_pages",
    "irfft2",
    "nearest_points",
    "rfft2",
    "solve_normal_equation_",
    "update_splits_",
]
