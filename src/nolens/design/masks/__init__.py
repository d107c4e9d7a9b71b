"""Surfaces of masks: regular and random lenslets, diffusers, and masks designed for their PSF."""

from nolens.design.masks.blank import RELIEF_FILE, Blank, MadeMask, TileDescent
from nolens.design.masks.contour import contour_relief, correlation, line_target, random_contours
from nolens.design.masks.figures import MaskComparison
from nolens.design.masks.limits import Limits
from nolens.design.masks.optimised import PsfGoals, Shortfall, lenslet_start, optimised_relief
from nolens.design.masks.surfaces import (
    Arrangement,
    gaussian_diffuser,
    lenslet_array,
    smoothing_margin,
)
from nolens.design.masks.tile import (
    Layout,
    Tile,
    View,
    default_period_um,
    focusing_radius_um,
    quarter_um,
    spread_over,
)

__all__ = [
    "RELIEF_FILE",
    "Arrangement",
    "Blank",
    "Layout",
    "Limits",
    "MadeMask",
    "MaskComparison",
    "PsfGoals",
    "Shortfall",
    "Tile",
    "TileDescent",
    "View",
    "contour_relief",
    "correlation",
    "default_period_um",
    "focusing_radius_um",
    "gaussian_diffuser",
    "lenslet_array",
    "lenslet_start",
    "line_target",
    "optimised_relief",
    "quarter_um",
    "random_contours",
    "smoothing_margin",
    "spread_over",
]
