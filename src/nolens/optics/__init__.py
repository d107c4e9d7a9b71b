"""Optics of plane layers under a relief: rays, waves, and the pattern of a point of light."""

from nolens.optics.grid import Grid
from nolens.optics.illumination import ChiefRay, Illumination, PointSource
from nolens.optics.lenslets import (
    random_lenslets,
    relaxed_points,
    smoothed,
    squared_distance,
)
from nolens.optics.mask import MaskSurface, Opening
from nolens.optics.pattern import Media, point_pattern
from nolens.optics.propagation import pass_layers_, propagate
from nolens.optics.rays import (
    Number,
    mask_to_sensor,
    refraction,
    through,
    through_layers,
    translation,
)
from nolens.optics.relief import Relief
from nolens.optics.stack import Stack, transmittance
from nolens.optics.windows import Margin, divergence

__all__ = [
    "ChiefRay",
    "Grid",
    "Illumination",
    "Margin",
    "MaskSurface",
    "Media",
    "Number",
    "Opening",
    "PointSource",
    "Relief",
    "Stack",
    "divergence",
    "mask_to_sensor",
    "pass_layers_",
    "point_pattern",
    "propagate",
    "random_lenslets",
    "refraction",
    "relaxed_points",
    "smoothed",
    "squared_distance",
    "through",
    "through_layers",
    "translation",
    "transmittance",
]
