from .dots import Angles, Dot, Spot, angles_of, brightest_places, grade, spots_at
from .edge import EdgeResolution, edge_response, slanted_edge
from .picture import affine_fit, psnr, scale_fit, ssim
from .psf import (
    PatternFigures,
    PsfFigures,
    clipped_pixels,
    pattern_figures,
    psf_figures,
    sparsity,
    spectral_magnitude,
)
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
    "Dot",
    "EdgeResolution",
    "FlatPicture",
    "ObservedPair",
    "PatternFigures",
    "PointPair",
    "PsfFigures",
    "ResolvedSeparation",
    "Spot",
    "StarResolution",
    "TwoPoints",
    "affine_fit",
    "angles_of",
    "brightest_places",
    "clipped_pixels",
    "edge_response",
    "find_star",
    "grade",
    "pattern_figures",
    "point_pair",
    "psf_figures",
    "psnr",
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
]
