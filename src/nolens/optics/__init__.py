"""Optics of plane layers under a relief: rays, waves, and the pattern of a point of light."""

from nolens.optics.grid import Grid
from nolens.optics.illumination import ChiefRay, Illumination, PointSource
from nolens.optics.mask import MaskSurface, Opening
from nolens.optics.pattern import Media, point_pattern
from nolens.optics.propagation import propagate
from nolens.optics.rays import mask_to_sensor, refraction, through, translation
from nolens.optics.relief import Relief, random_lenslets
from nolens.optics.stack import Stack, transmittance
from nolens.optics.windows import Margin, divergence

__all__ = [
    "ChiefRay",
    "Grid",
    "Illumination",
    "Margin",
    "MaskSurface",
    "Media",
    "Opening",
    "PointSource",
    "Relief",
    "Stack",
    "divergence",
    "mask_to_sensor",
    "point_pattern",
    "propagate",
    "random_lenslets",
    "refraction",
    "through",
    "translation",
    "transmittance",
]
