"""Pictures at any depth from one measurement, and how far away things are.

`PsfBetween` gives the PSF of any depth from those of a few, `Search` finds the sharpest depth,
`focal_stack` reconstructs many and `all_in_focus` makes one picture and a depth map of them.
"""

from nolens.refocusing.all_in_focus import AllInFocus, all_in_focus
from nolens.refocusing.depth_of_focus import (
    depth_of_focus_per_m,
    depth_um,
    even_depths,
    line_cells,
    lit_cells,
    per_m,
)
from nolens.refocusing.psf_between import PsfAt, PsfBetween, measured_reduced_um
from nolens.refocusing.sharpest import Search, Sharpest, Tried
from nolens.refocusing.solving import Solving, sharpness
from nolens.refocusing.stack import Stack, focal_stack

__all__ = [
    "AllInFocus",
    "PsfAt",
    "PsfBetween",
    "Search",
    "Sharpest",
    "Solving",
    "Stack",
    "Tried",
    "all_in_focus",
    "depth_of_focus_per_m",
    "depth_um",
    "even_depths",
    "focal_stack",
    "line_cells",
    "lit_cells",
    "measured_reduced_um",
    "per_m",
    "sharpness",
]
