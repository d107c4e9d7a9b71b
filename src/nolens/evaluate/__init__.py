"""How good a picture is against the truth, and what a point spread function looks like."""

from nolens.evaluate.pattern import PatternFigures, pattern_figures
from nolens.evaluate.picture import affine_fit, psnr, scale_fit, ssim
from nolens.evaluate.transfer import modulation_transfer, sparsity

__all__ = [
    "PatternFigures",
    "affine_fit",
    "modulation_transfer",
    "pattern_figures",
    "psnr",
    "scale_fit",
    "sparsity",
    "ssim",
]
