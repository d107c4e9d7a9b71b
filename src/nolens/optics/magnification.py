"""A PSF magnified about its zero shift, as the distance of its source does it."""

import math

import torch
from torch import Tensor

from nolens.errors import OptionError

_LOBES = 4
"""Zeros of the sinc to each side that the kernel of `magnified` has."""


def magnified(psf: Tensor, factor: float, *, moved: tuple[float, float] = (0.0, 0.0)) -> Tensor:
    r"""PSF magnified about its zero shift, with its energy kept: :math:`p(x / M) / M^2`.

    The PSF is a shadow of the mask: a source at the distance z magnifies it by
    :math:`M = 1 + D / z`, with :math:`D = Σ t_j / n_j` of the layers down to the sensor
    (`uvimprint`, sec. 3.5). Values between pixels come from a sinc under the main lobe of a wider
    one (`duchon1979`), stretched where the PSF shrinks so that nothing is missed between
    samples. It undershoots beside sharp spots; cut off at zero the PSF would have more light.

    Parameters
    ----------
    psf
        (..., rows, columns); zero shift is the pixel (rows // 2, columns // 2).
    factor
        M, more than zero.
    moved
        Pixels by which the result is moved down and to the right.

    Returns
    -------
    Tensor
        Of the same shape and type. Places that lie beyond the PSF have no light; `covered`
        says which.

    Raises
    ------
    OptionError
        If the factor is not a finite number above zero.
    """
    if not 0 < factor < math.inf:
        raise OptionError(
            f"a magnification of {factor:g}: it must be a number above 0, such as 1.01"
        )
    if factor == 1 and moved == (0.0, 0.0):
        return psf.clone()
    result = psf
    for axis, shift in zip((-2, -1), moved, strict=True):
        result = _resampled(result, axis, factor, shift)
    return result.div_(factor * factor)


def covered(
    size: tuple[int, int], factor: float, *, moved: tuple[float, float] = (0.0, 0.0)
) -> Tensor:
    """Pixels of a `magnified` PSF that lie within what was there; bool, (rows, columns)."""
    inside = []
    for count, shift in zip(size, moved, strict=True):
        place = _places(count, factor, shift)
        inside.append((place >= 0) & (place <= count - 1))
    return inside[0][:, None] & inside[1]


def _places(count: int, factor: float, shift: float) -> Tensor:
    """Place in the PSF that each pixel of the result is taken from; float64."""
    middle = count // 2
    return (torch.arange(count, dtype=torch.float64) - middle - shift) / factor + middle


def _resampled(psf: Tensor, axis: int, factor: float, shift: float) -> Tensor:
    """The PSF at `_places` along one axis."""
    count = psf.shape[axis]
    place = _places(count, factor, shift)
    stretch = max(1.0, 1 / factor)
    extent = math.ceil(_LOBES * stretch)
    first = place.floor().long() - extent + 1
    taps = first[:, None] + torch.arange(2 * extent)
    weight = _kernel((place[:, None] - taps) / stretch)
    weight /= weight.sum(dim=1, keepdim=True)
    weight *= (taps >= 0) & (taps < count)
    shape = [1] * psf.ndim
    shape[axis] = count
    result = torch.zeros_like(psf)
    for tap, each in zip(taps.clamp(0, count - 1).T, weight.T, strict=True):
        result += psf.index_select(axis, tap) * each.to(psf.dtype).reshape(shape)
    return result


def _kernel(distance: Tensor) -> Tensor:
    """Sinc under the main lobe of a wider one."""
    inside = distance.abs() < _LOBES
    return torch.where(inside, torch.sinc(distance) * torch.sinc(distance / _LOBES), 0.0)
