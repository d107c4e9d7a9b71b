from .admm import PassSums, Repeater, SplitState, solve_normal_equation_, update_splits_
from .differences import (
    OPPONENTS,
    Coupling,
    Shrinkage,
    add_pulls_,
    difference_rows,
    move_differences_,
    scale_multipliers_,
)
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
    "OPPONENTS",
    "Coupling",
    "LayerTransfer",
    "PassSums",
    "Repeater",
    "Shrinkage",
    "SplitState",
    "add_pulls_",
    "apply_transfer_",
    "difference_rows",
    "fast_length",
    "fft2_",
    "ifft2_",
    "ifft2_window",
    "in_large_pages",
    "irfft2",
    "irfft2_window_",
    "irfft2_windows_",
    "move_differences_",
    "nearest_points",
    "odd_spline_",
    "rfft2",
    "rfft2_window",
    "scale_multipliers_",
    "solve_normal_equation_",
    "update_splits_",
]
