"""Linear operators with an adjoint, over tensors `(..., channels, height, width)`."""

from nolens.operators.base import LinearOperator
from nolens.operators.convolution import CroppedConvolution
from nolens.operators.difference import FiniteDifference
from nolens.operators.geometry import Geometry, Region

__all__ = ["CroppedConvolution", "FiniteDifference", "Geometry", "LinearOperator", "Region"]
