"""What a lensless camera hands over, as plain data: frames, measurements, PSFs and pictures.

A `Frame` is what a file holds (stored counts, colour mosaic, black and white level).
`develop` makes a linear `Measurement` of it, `prepare_psf` makes a point spread function fit
a measurement, and the functions of `picture` turn the radiance that comes out into values a
screen can show. Nothing in here reads or writes a file.
"""

from nolens.camera.frame import MOSAICS, Frame
from nolens.camera.measurement import Measurement, dark_corner, develop
from nolens.camera.picture import (
    arrange_rgb,
    exposure_white,
    linear_from_srgb,
    srgb_from_linear,
)
from nolens.camera.psf import PreparedPsf, prepare_psf

__all__ = [
    "MOSAICS",
    "Frame",
    "Measurement",
    "PreparedPsf",
    "arrange_rgb",
    "dark_corner",
    "develop",
    "exposure_white",
    "linear_from_srgb",
    "prepare_psf",
    "srgb_from_linear",
]
