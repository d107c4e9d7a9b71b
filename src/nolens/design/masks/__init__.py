"""Surfaces of masks: regular and random lenslets, diffusers, and masks designed for their PSF."""

from nolens.design.masks.contour import (
    contour_relief,
    correlation,
    line_target,
    random_contours,
)
from nolens.design.masks.figures import (
    FREQUENCIES_PER_MM,
    MaskFigures,
    central_psf,
    mask_figures,
    spread_over,
)
from nolens.design.masks.goals import PsfGoals, Shortfall
from nolens.design.masks.layout import (
    Layout,
    default_period_um,
    focusing_radius_um,
    quarter_um,
)
from nolens.design.masks.limits import Limits
from nolens.design.masks.optimised import lenslet_start, optimised_relief
from nolens.design.masks.surfaces import (
    Arrangement,
    gaussian_diffuser,
    lenslet_array,
    smoothing_margin,
)
from nolens.design.masks.tile import Tile, View

__all__ = [
    "FREQUENCIES_PER_MM",
    "Arrangement",
    "Layout",
    "Limits",
    "MaskFigures",
    "PsfGoals",
    "Shortfall",
    "Tile",
    "View",
    "central_psf",
    "contour_relief",
    "correlation",
    "default_period_um",
    "focusing_radius_um",
    "gaussian_diffuser",
    "lenslet_array",
    "lenslet_start",
    "line_target",
    "mask_figures",
    "optimised_relief",
    "quarter_um",
    "random_contours",
    "smoothing_margin",
    "spread_over",
]
