from .bootstrap import Interval, bootstrap_mean
from .comparison import (
    Comparison,
    Fit,
    Perceptual,
    compare_pictures,
    lies_beside,
    turned_over,
)
from .dots import Angles, Dot, Spot, angles_of, brightest_places, grade, spots_at
from .edge import EdgeResolution, edge_response, slanted_edge
from .perceptual import perceptual_distance
from .picture import affine_fit, ms_ssim, psnr, scale_fit, ssim
from .psf import (
    PatternFigures,
    PsfFigures,
    clipped_pixels,
    pattern_figures,
    psf_figures,
    sparsity,
    spectral_magnitude,
)
from .registration import Motion, Registration, register_picture
from .screen import FlatPicture
from .siemens import (
    StarResolution,
    find_star,
    resolved_radii,
    siemens_star,
    star_contrast,
    star_square_deg,
)
from .two_points import (
    RAYLEIGH_DIP,
    ObservedPair,
    PointPair,
    ResolvedSeparation,
    TwoPoints,
    point_pair,
    resolved_separation,
)

__all__ = [
    "RAYLEIGH_DIP",
    "Angles",
    "Comparison",
    "Dot",
    "EdgeResolution",
    "Fit",
    "FlatPicture",
    "Interval",
    "Motion",
    "ObservedPair",
    "PatternFigures",
    "Perceptual",
    "PointPair",
    "PsfFigures",
    "Registration",
    "ResolvedSeparation",
    "Spot",
    "StarResolution",
    "TwoPoints",
    "affine_fit",
    "angles_of",
    "bootstrap_mean",
    "brightest_places",
    "clipped_pixels",
    "compare_pictures",
    "edge_response",
    "find_star",
    "grade",
    "lies_beside",
    "ms_ssim",
    "pattern_figures",
    "perceptual_distance",
    "point_pair",
    "psf_figures",
    "psnr",
    "register_picture",
    "resolved_radii",
    "resolved_separation",
    "scale_fit",
    "siemens_star",
    "slanted_edge",
    "sparsity",
    "spectral_magnitude",
    "spots_at",
    "ssim",
    "star_contrast",
    "star_square_deg",
    "turned_over",
]
