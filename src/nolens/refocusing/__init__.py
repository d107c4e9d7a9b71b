"""Pictures at any depth from one measurement, and how far away things are.

`PsfBetween` gives the PSF of any depth from those of a few, `Autofocus` finds the sharpest depth,
`focal_stack` reconstructs many and `all_in_focus` makes one picture and a depth map of them.
"""

from nolens.refocusing.autofocus import Autofocus, AutofocusResult
from nolens.refocusing.depth import (
    depth_of_focus_per_m,
    depth_um,
    even_depths,
    line_pixels,
    lit_pixels,
    per_m,
)
from nolens.refocusing.focal_stack import (
    AllInFocus,
    DepthReconstructor,
    FocalStack,
    all_in_focus,
    focal_stack,
    sharpness,
)
from nolens.refocusing.psf_between import (
    PsfAt,
    PsfBetween,
    cut_alike,
    explained_by,
    measured_reduced_um,
    reduced_um,
)

__all__ = [
    "AllInFocus",
    "Autofocus",
    "AutofocusResult",
    "DepthReconstructor",
    "FocalStack",
    "PsfAt",
    "PsfBetween",
    "all_in_focus",
    "cut_alike",
    "depth_of_focus_per_m",
    "depth_um",
    "even_depths",
    "explained_by",
    "focal_stack",
    "line_pixels",
    "lit_pixels",
    "measured_reduced_um",
    "per_m",
    "reduced_um",
    "sharpness",
]
