"""What a person should know about a PSF and a measurement before they are put together."""

import torch
from torch import Tensor

from nolens.camera.measurement import Measurement, darkest_corner

_SATURATED_SHARE = 1e-3
_CORNER_SHARE = 1e-2
_HAS_CORNERS = 60  # Below, the corners' pixels reach into the middle half of the PSF.
_EDGE_SHARE = 0.2
_MIDDLE = 1024
_STEPS = (2, 4)
_CLEAR = 0.1
_FINER = 3.0
_LEAST_SHARPNESS = 0.01


def psf_warnings(psf: Measurement, values: Tensor) -> list[str]:
    """Sentences, one for each warning of a PSF alone.

    Parameters
    ----------
    psf
        The developed PSF, as its file has it.
    values
        Its values on the pixels that are used, (channels, height, width).
    """
    texts = []
    saturated = float((~psf.valid).float().mean())
    if saturated > _SATURATED_SHARE:
        texts.append(
            f"{100 * saturated:.2g} % of the PSF {psf.source} is saturated, and its peaks are "
            "cut off there: a shorter exposure of the point source gives a better picture"
        )
    if not _is_dark_somewhere(psf, values):
        corner, peak = darkest_corner(values), float(values.max())
        texts.append(
            f"the darkest corner of the PSF {psf.source} is {corner:.3g}, "
            f"{100 * corner / peak:.2g} % of its peak: if no light falls there, this is a black "
            "level that the file does not state: subtract it (with a dark frame; reconstruct and "
            "measure psf also take --black auto)"
        )
    return texts


def pair_warnings(psf: Measurement, values: Tensor, measurement: Measurement) -> list[str]:
    """Sentences, one for each warning of a PSF beside a measurement; as `psf_warnings`."""
    texts = []
    edge = edge_warning(psf.source, values, measurement.size)
    if edge is not None and _is_dark_somewhere(psf, values):
        texts.append(edge)
    if finer_than(measurement.values, values):
        texts.append(
            f"the measurement {measurement.source} has finer detail than the PSF {psf.source}, and "
            "a measurement is the scene blurred by the PSF: the two files may be swapped"
        )
    return texts


def _is_dark_somewhere(psf: Measurement, values: Tensor) -> bool:
    """Whether its black level is known, or its darkest corner says that it is 0."""
    if psf.black_stated or min(values.shape[-2:]) < _HAS_CORNERS:
        return True
    return darkest_corner(values) <= _CORNER_SHARE * float(values.max())


def edge_warning(source: str, values: Tensor, sensor: tuple[int, int]) -> str | None:
    """Warn of a PSF that goes on beyond the sensor; None where it does not, or is known there.

    Parameters
    ----------
    source
        Where it comes from.
    values
        (channels, height, width).
    sensor
        (height, width) of the measurement; where the PSF is larger, it is known beyond.
    """
    plane = values.mean(dim=0)
    deep = max(1, min(plane.shape) // 32)
    edges = [
        part.flatten()
        for axis in (0, 1)
        if plane.shape[axis] <= sensor[axis]
        for part in (
            plane.narrow(axis, 0, deep),
            plane.narrow(axis, plane.shape[axis] - deep, deep),
        )
    ]
    if not edges or float(torch.cat(edges).mean()) <= _EDGE_SHARE * float(plane.mean()):
        return None
    return (
        f"the PSF {source} has light up to the sensor's edges: what falls beyond them is missing "
        "from it, and pictures come out poor, depths wrong. Give an extended PSF "
        "(nolens calibrate stitch or extrapolate; of a simulated camera nolens psf --cells) with "
        "--psf-extent wide and --support"
    )


def finer_than(measured: Tensor, psf: Tensor) -> bool:
    """Whether a measurement has clearly finer detail than a PSF, both (channels, height, width).

    A measurement is a weighted mean of shifted PSFs, so its detail is no finer.
    """
    for step in _STEPS:
        one, other = _sharpness(measured, step), _sharpness(psf, step)
        if one is not None and other is not None and one > max(_FINER * other, _LEAST_SHARPNESS):
            return True
    return False


def _sharpness(values: Tensor, step: int) -> float | None:
    r"""How fast the autocovariance c of the middle falls, next to its peak; None if unclear.

    :math:`1 - (8 c_{1+s} - 3 c_{1+2s}) / 5 c_1` over s pixels: a peak that is only a parabola
    counts nothing, and white noise has no part in it, as :math:`c_0` is left out.
    """
    plane = values.mean(dim=0)
    rows, columns = (min(_MIDDLE, side) for side in plane.shape)
    top, left = (plane.shape[0] - rows) // 2, (plane.shape[1] - columns) // 2
    plane = plane[top : top + rows, left : left + columns]
    if min(plane.shape) < 8 * step:
        return None
    plane = plane - plane.mean()
    near, middle, far = (_covariance(plane, lag) for lag in (1, 1 + step, 1 + 2 * step))
    if near <= _CLEAR * float(plane.square().mean()):
        return None
    return 1 - (8 * middle - 3 * far) / (5 * near)


def _covariance(plane: Tensor, lag: int) -> float:
    """Of pixels so far apart, mean over both directions."""
    down = (plane[lag:] * plane[:-lag]).mean()
    right = (plane[:, lag:] * plane[:, :-lag]).mean()
    return 0.5 * float(down + right)
