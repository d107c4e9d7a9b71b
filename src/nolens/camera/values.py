"""Values of frames and pictures: whether they can be computed with, exposure, the sRGB curve."""

import math

import torch
from torch import Tensor

from nolens.errors import DataError

_LARGEST = 1e15
"""Beyond this, and below its inverse, sums of squares leave the range of float32."""
_EXPOSED = 0.995


def unusable(values: Tensor) -> str | None:
    """Why values of a file cannot be computed with, as the end of a sentence; None where they can.

    Zeros are no reason.
    """
    low, high = (float(each) for each in values.aminmax())
    largest = max(abs(low), abs(high))
    if not math.isfinite(largest):
        count = int((~torch.isfinite(values)).sum())
        return (
            f"{count} values that are NaN or infinite, of {values.numel()}: repair them before, "
            "for example by the mean of their neighbours"
        )
    if largest > _LARGEST or 0 < largest < 1 / _LARGEST:
        return (
            f"values up to {largest:.3g}, and {1 / _LARGEST:g} to {_LARGEST:g} can be computed "
            "with: multiply them all by one number"
        )
    return None


def all_finite(values: Tensor) -> bool:
    """Whether no value is NaN or infinite.

    A sum is finite only if its terms are, and costs a tenth of looking at each of them, which
    is left for sums that overflow.
    """
    return bool(torch.isfinite(values.sum())) or bool(torch.isfinite(values).all())


def squares(values: Tensor) -> Tensor:
    """Sum of the squares of each plane of (..., height, width), float64.

    Of norms of rows: all values in float64 take forty times as long, and norms of millions of
    values in float32 can be wrong in the fourth digit.
    """
    rows: Tensor = torch.linalg.vector_norm(values, dim=-1).double()
    return rows.square().sum(dim=-1)


def exposure_white(radiance: Tensor) -> float:
    """Radiance that a picture shows as white: its 99.5th percentile.

    Taken over the brightest channel of every pixel, as the smallest value that at least 99.5 %
    of the pixels do not exceed. What is brighter is clipped; zero stays black, nothing is
    subtracted. Where this percentile is dark (a few point sources on black), the brightest
    value is white.

    Parameters
    ----------
    radiance
        Linear radiance, (channels, height, width), in any unit.

    Raises
    ------
    DataError
        If the radiance holds NaN or infinity, or is nowhere above zero.
    """
    if not all_finite(radiance):
        raise DataError("the picture holds NaN or infinity and cannot be shown or written")
    brightest = radiance.amax(dim=0).flatten()
    rank = math.ceil(_EXPOSED * brightest.numel())
    white = float(brightest.kthvalue(rank).values)
    if white <= 0:
        white = float(brightest.max())
    if white <= 0:
        raise DataError(
            "the picture is black everywhere: there is nothing to show. A smaller tau "
            "(--tau), light from everywhere (--support full), or another PSF, may help"
        )
    return white


def srgb_from_linear(linear: Tensor) -> Tensor:
    """The sRGB curve of IEC 61966-2-1, of linear values of any shape, clipped to 0…1.

    ``12.92 x`` for x up to 0.0031308, then ``1.055 x^(1/2.4) - 0.055``.
    """
    x = linear.clamp(0, 1)
    curved = x.pow(1 / 2.4).mul_(1.055).sub_(0.055)
    return torch.where(x <= 0.0031308, x.mul_(12.92), curved)


def linear_from_srgb(encoded: Tensor) -> Tensor:
    """The inverse of `srgb_from_linear`, for values of 0…1."""
    x = encoded.clamp(0, 1)
    return torch.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055).pow(2.4))


def arrange_rgb(values: Tensor, channels: tuple[str, ...]) -> Tensor:
    """Put channels where a picture has them: one as it is, several as R, G, B.

    Parameters
    ----------
    values
        (channels, height, width).
    channels
        Their names, such as ``("R", "G")``. A colour that is missing beside others is zero.
    """
    if len(channels) == 1:
        return values
    missing = torch.zeros_like(values[0])
    planes = dict(zip(channels, values, strict=True))
    return torch.stack([planes.get(colour, missing) for colour in "RGB"])
