"""How good a picture is, against the truth."""

from nolens.evaluate.picture import affine_fit, psnr, scale_fit, ssim

__all__ = ["affine_fit", "psnr", "scale_fit", "ssim"]
