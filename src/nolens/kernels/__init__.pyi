from .admm import PassSums, Repeater, SplitState, solve_normal_equation_, update_splits_
from .fft import (
    fast_length,
    fft2_,
    ifft2_,
    ifft2_window,
    in_large_pages,
    irfft2,
    irfft2_window_,
    irfft2_windows_,
    rfft2,
    rfft2_window,
)
from .nearest import nearest_points
from .spline import odd_spline_
from .transfer import LayerTransfer, apply_transfer_

__all__ = [
    "LayerTransfer",
    "PassSums",
    "Repeater",
    "SplitState",
    "apply_transfer_",
    "fast_length",
    "fft2_",
    "ifft2_",
    "ifft2_window",
    "in_large_pages",
    "irfft2",
    "irfft2_window_",
    "irfft2_windows_",
    "nearest_points",
    "odd_spline_",
    "rfft2",
    "rfft2_window",
    "solve_normal_equation_",
    "update_splits_",
]
