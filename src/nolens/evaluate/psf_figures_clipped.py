"""Tops of a pattern that are cut off."""

from torch import Tensor

_FEW = 9
_SHARE = 1e-4


def clipped_cells(pattern: Tensor) -> int:
    """Cells that have the very largest value, where many of them lie side by side; otherwise 0.

    Tops that happen to be of the same height are one thing, level tops another.

    Parameters
    ----------
    pattern
        (rows, columns).
    """
    top = pattern == pattern.max()
    beside = int((top[1:] & top[:-1]).sum() + (top[:, 1:] & top[:, :-1]).sum())
    return int(top.sum()) if beside > max(_FEW, _SHARE * pattern.numel()) else 0
