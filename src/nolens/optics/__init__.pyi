from .illumination import Illumination, PointSource
from .layers import (
    Number,
    Stack,
    mask_to_sensor,
    refraction,
    through,
    through_layers,
    translation,
    transmittance,
)
from .lenslets import random_lenslets, relaxed_points, smoothed, squared_distance, surface_bytes
from .mask import Grid, MaskSurface, Opening, Relief
from .propagation import pass_layers_, propagate
from .psf import Margin, Media, divergence, monochromatic_psf, monochromatic_psf_bytes

__all__ = [
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
    "monochromatic_psf",
    "monochromatic_psf_bytes",
    "pass_layers_",
    "propagate",
    "random_lenslets",
    "refraction",
    "relaxed_points",
    "smoothed",
    "squared_distance",
    "surface_bytes",
    "through",
    "through_layers",
    "translation",
    "transmittance",
]
