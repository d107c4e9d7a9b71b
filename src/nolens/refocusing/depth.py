"""Depths in even steps of 1/z, and what of a PSF tells them apart."""

import math

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import irfft2, rfft2


def per_m(depth_um: float) -> float:
    """1/z in 1/m (dioptres); 0 for infinity. Magnification is linear in it."""
    return 1e6 / depth_um


def depth_um(vergence_per_m: float) -> float:
    """Inverse of `per_m`."""
    return 1e6 / vergence_per_m if vergence_per_m > 0 else math.inf


def depth_mm(depth_um: float) -> float | str:
    """A depth as JSON has it: mm, or the word infinity."""
    return "infinity" if math.isinf(depth_um) else round(depth_um * 1e-3, 3)


def even_depths(near_um: float, far_um: float, steps: int) -> tuple[float, ...]:
    """Depths from near to far, in equal steps of 1/z.

    Parameters
    ----------
    near_um, far_um
        The first and the last; the last may be infinite.
    steps
        How many, 2 or more.
    """
    first, last = per_m(near_um), per_m(far_um)
    inner = [first + (last - first) * step / (steps - 1) for step in range(1, steps - 1)]
    return (near_um, *(depth_um(each) for each in inner), far_um)


def line_pixels(psf: Tensor) -> float:
    r"""Width of a PSF's lines: half-width of its autocorrelation, divided by √2.

    Autocorrelation :math:`F^{-1}|F(p - \bar p)|^2`, full width at half maximum, mean of rows and
    columns (`uvimprint`, fig. 5b).

    Parameters
    ----------
    psf
        (channels, rows, columns).

    Returns
    -------
    float
        In pixels.

    Raises
    ------
    DataError
        If the PSF is even, or its lines are wider than half of it.
    """
    plane = psf.mean(dim=0)
    spectrum = rfft2((plane - plane.mean()).contiguous())
    correlation = irfft2(
        spectrum.abs().square().to(spectrum.dtype), (plane.shape[0], plane.shape[1])
    )
    if not float(correlation[0, 0]) > 0:
        raise DataError("the PSF is even: it has no lines that tell depths apart")
    halves = [_half(line / line[0]) for line in (correlation[:, 0], correlation[0])]
    return math.sqrt(2) * sum(halves) / len(halves)


def _half(profile: Tensor) -> float:
    """Where a profile that starts at 1 falls below a half."""
    below = (profile[: len(profile) // 2] < 0.5).nonzero()
    if len(below) == 0:
        raise DataError("the PSF is blurred: its lines are wider than half of it")
    first = int(below[0])
    before, after = float(profile[first - 1]), float(profile[first])
    return first - 1 + (before - 0.5) / (before - after)


def lit_pixels(psf: Tensor, sensor: tuple[int, int]) -> float:
    """Half of the longer side of what a PSF lights on the sensor, in pixels.

    Parameters
    ----------
    psf
        (channels, rows, columns), its zero shift in the middle.
    sensor
        (rows, columns) of the sensor.
    """
    plane = psf.mean(dim=0)
    lit = []
    for axis, count in enumerate(sensor):
        profile = plane.sum(dim=1 - axis).double()
        away = (torch.arange(len(profile)) - len(profile) // 2).abs()
        bright = away[profile > 0.05 * profile.max()]
        lit.append(min(count / 2, float(bright.max()) + 0.5))
    return max(lit)


def depth_of_focus_per_m(line: float, reduced_um: float, lit: float) -> float:
    r"""Difference of 1/z by which the PSF's edge moves by one line: :math:`w / (D\,r)`.

    A source at z magnifies the PSF by :math:`1 + D/z` (`uvimprint`, sec. 3.5), so what lies r
    from the middle moves by :math:`r D\,Δ(1/z)`. A depth that is off by this much blurs a point
    over two lines' width: it is the depth of field of a camera whose lens is as wide as the lit
    part of the sensor.

    Parameters
    ----------
    line
        Width w of the PSF's lines.
    reduced_um
        D, the reduced distance of mask and sensor, Σ thickness / index.
    lit
        Half of the lit part's longer side, r, in the unit of the width.
    """
    return 1e6 * line / (reduced_um * lit)
