"""How good a picture is against the truth, and what a point spread function looks like."""

from nolens.evaluate.dots import Angles, Dot, Spot, angles_of, brightest_places, grade, spots_at
from nolens.evaluate.field import PeakCorrelation, falls_to, peak_correlation
from nolens.evaluate.pattern import PatternFigures, pattern_figures
from nolens.evaluate.picture import affine_fit, psnr, scale_fit, ssim
from nolens.evaluate.psf_figures import PsfFigures, clipped_cells, psf_figures
from nolens.evaluate.siemens import (
    STAR_THRESHOLD,
    ResolvedRadius,
    StarContrast,
    StarPlace,
    find_star,
    resolved_radii,
    star_contrast,
)
from nolens.evaluate.slanted_edge import EdgeResponse, edge_response
from nolens.evaluate.spectral_magnitude import sparsity, spectral_magnitude
from nolens.evaluate.targets import (
    STAR_SHARE,
    angle_of_length,
    siemens_star,
    slanted_edge,
    star_square_deg,
)
from nolens.evaluate.two_points import (
    RAYLEIGH_DIP,
    PointPair,
    ResolvedSeparation,
    point_pair,
    resolved_separation,
)

__all__ = [
    "RAYLEIGH_DIP",
    "STAR_SHARE",
    "STAR_THRESHOLD",
    "Angles",
    "Dot",
    "EdgeResponse",
    "PatternFigures",
    "PeakCorrelation",
    "PointPair",
    "PsfFigures",
    "ResolvedRadius",
    "ResolvedSeparation",
    "Spot",
    "StarContrast",
    "StarPlace",
    "affine_fit",
    "angle_of_length",
    "angles_of",
    "brightest_places",
    "clipped_cells",
    "edge_response",
    "falls_to",
    "find_star",
    "grade",
    "pattern_figures",
    "peak_correlation",
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
