"""Linear operators with an adjoint, over tensors `(..., channels, height, width)`."""

from nolens.operators.base import LinearOperator
from nolens.operators.convolution import CroppedConvolution, Geometry, PixelRectangle
from nolens.operators.difference import FiniteDifference, StackDifference
from nolens.operators.field_convolution import TRANSFER_BYTES, FieldConvolution, mean_psf
from nolens.operators.pixelwise import Crop, Diagonal, Identity
from nolens.operators.slow_light import SlowLightRemoval, slow_cosines, slow_waves
from nolens.operators.stack_convolution import StackConvolution
from nolens.operators.stacks import BlockDiagonal, HorizontalStack, VerticalStack

__all__ = [
    "TRANSFER_BYTES",
    "BlockDiagonal",
    "Crop",
    "CroppedConvolution",
    "Diagonal",
    "FieldConvolution",
    "FiniteDifference",
    "Geometry",
    "HorizontalStack",
    "Identity",
    "LinearOperator",
    "PixelRectangle",
    "SlowLightRemoval",
    "StackConvolution",
    "StackDifference",
    "VerticalStack",
    "mean_psf",
    "slow_cosines",
    "slow_waves",
]
