"""Linear operators with an adjoint, over tensors `(..., channels, height, width)`."""

from nolens.operators.base import LinearOperator
from nolens.operators.convolution import CroppedConvolution, Geometry, PixelRectangle
from nolens.operators.difference import FiniteDifference

__all__ = ["CroppedConvolution", "FiniteDifference", "Geometry", "LinearOperator", "PixelRectangle"]
