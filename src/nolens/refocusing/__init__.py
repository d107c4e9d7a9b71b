"""Pictures at any depth from one measurement, and how far away things are.

`PsfBetween` gives the PSF of any depth from those of a few, `DepthPsfs` those of a measurement,
`Autofocus` finds the sharpest depth, `focus` reconstructs one and `focal_stack` many, and
`all_in_focus` makes one picture and a depth map of them. `transparent` does so for planes that were
solved together, `spacing_warnings` looks at their depths.
"""

from nolens.refocusing.autofocus import Autofocus, AutofocusResult, Focused, focus
from nolens.refocusing.depth import (
    depth_mm,
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
    DepthField,
    DepthPsfs,
    PsfAt,
    PsfBetween,
    measured_reduced_um,
    reduced_um,
)
from nolens.refocusing.volume import photon_variance, spacing_warnings, transparent

__all__ = [
    "AllInFocus",
    "Autofocus",
    "AutofocusResult",
    "DepthField",
    "DepthPsfs",
    "DepthReconstructor",
    "FocalStack",
    "Focused",
    "PsfAt",
    "PsfBetween",
    "all_in_focus",
    "depth_mm",
    "depth_of_focus_per_m",
    "depth_um",
    "even_depths",
    "focal_stack",
    "focus",
    "line_pixels",
    "lit_pixels",
    "measured_reduced_um",
    "per_m",
    "photon_variance",
    "reduced_um",
    "sharpness",
    "spacing_warnings",
    "transparent",
]
