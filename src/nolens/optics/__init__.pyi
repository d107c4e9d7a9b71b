from .grid import Grid
from .illumination import ChiefRay, Illumination, PointSource
from .lenslets import (
    random_lenslets,
    relaxed_points,
    smoothed,
    squared_distance,
    surface_bytes,
)
from .mask import MaskSurface, Opening
from .pattern import Media, pattern_bytes, point_pattern
from .propagation import pass_layers_, propagate
from .rays import (
    Number,
    mask_to_sensor,
    refraction,
    through,
    through_layers,
    translation,
)
from .relief import Relief
from .stack import Stack, transmittance
from .windows import Margin, divergence

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
    "pattern_bytes",
    "point_pattern",
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
