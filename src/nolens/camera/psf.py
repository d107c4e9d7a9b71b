"""A point spread function that fits a measurement, and what a person should know of the two."""

from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.amounts import percent
from nolens.camera.measurement import Measurement, bin_mean, darkest_corner
from nolens.camera.values import squares
from nolens.errors import DataError, OptionError

_SATURATED_FRACTION = 1e-3
_SATURATED_MEASUREMENT = 1e-2
_CORNER_FRACTION = 1e-2
_HAS_CORNERS = 60  # Below, the corners' pixels reach into the middle half of the PSF.
_EDGE_FRACTION = 0.2
_MIDDLE = 1024
_STEPS = (2, 4)
_CLEAR = 0.1
_FINER = 3.0
_LEAST_SHARPNESS = 0.01
_PEAK_SIGMAS = 8.0
_NOISE_RATIO = 0.5
_NOISY = 0.01
_NEAR, _SURELY = 2.5, 4.0
"""Standard deviations of the noise around a PSF's median that its dark pixels lie within, and
standard errors by which their mean is below zero where the black level is too high."""

Flip = Literal["none", "vertical", "horizontal", "both"]
"""How a picture is turned over: upside down, left to right, or both, which is by 180°."""
_AXES: dict[Flip, tuple[int, ...]] = {
    "none": (),
    "vertical": (-2,),
    "horizontal": (-1,),
    "both": (-2, -1),
}


@dataclass(frozen=True)
class PsfGeometry:
    """How the pixels of a PSF's file lie on those of a measurement.

    Parameters
    ----------
    scale
        Pixels of the PSF along one of the measurement; None is 1, where the sizes allow no other.
    extended
        The PSF goes on beyond the sensor in both directions.
    partial
        The PSF is smaller than the sensor in both directions: its dark sides were cut off.
    flip
        How the PSF is to be turned over.
    """

    scale: int | None = None
    extended: bool = False
    partial: bool = False
    flip: Flip = "none"


SAME = PsfGeometry()
"""That of a PSF which the sensor itself measured."""


@dataclass(frozen=True)
class PreparedPsf:
    """A PSF on the pixels of a measurement, and what a person should know about it.

    Attributes
    ----------
    values
        float32, (channels, height, width); one channel serves all.
    warnings
        Sentences to show, one for each warning.
    notes
        Sentences that say what was done to make it fit.
    """

    values: Tensor
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()


def flipped(picture: Tensor, flip: Flip) -> Tensor:
    """Picture (…, height, width), turned over."""
    axes = _AXES[flip]
    return torch.flip(picture, axes) if axes else picture


def prepare_psf(
    psf: Measurement, measurement: Measurement, geometry: PsfGeometry = SAME
) -> PreparedPsf:
    """Make a PSF fit a measurement, or say why it does not.

    N×N pixels of a finer PSF are averaged into one. Where a PSF is smaller than the measurement,
    it is dark around its middle; where it is larger, what lies beyond the sensor stays, but for
    rows and columns without any light.

    Parameters
    ----------
    psf
        The developed PSF.
    measurement
        The measurement it is for.
    geometry
        How its pixels lie on the measurement's.

    Raises
    ------
    DataError
        If size, channels or mosaic do not fit, the PSF shows nothing above its background, or
        both hold the same.
    OptionError
        If the geometry's `scale` is less than 1.
    """
    _check_colours(psf, measurement)
    values = flipped(psf.values, geometry.flip)
    factor = _scale_that_fits(psf, measurement, geometry)
    if factor > 1:
        values = bin_mean(values, factor)
    warnings = check_psf(psf, values)
    if torch.equal(values, measurement.values):
        raise DataError(
            f"{measurement.source} and the PSF {psf.source} hold the same values: "
            "give what the sensor measured of the scene, and what it measured of a point source"
        )
    warnings += _pair_warnings(psf, values, measurement)
    values, notes = _widened(psf, values - _below_zero(values), measurement)
    return PreparedPsf(values, tuple(warnings), notes)


def _below_zero(values: Tensor) -> Tensor:
    """What a black level that is too high took from each channel, zero or less, to be subtracted.

    Half of the noise of dark pixels is below zero, and stays. Where the median is below it, and
    the pixels around the median are surely in their mean, as light is not, that mean is the zero.
    """
    planes = values.flatten(1)
    if not any(int((each < 0).count_nonzero()) > planes.shape[1] / 2 for each in planes):
        return planes.new_zeros(())  # No median is: sorting all values takes much longer.
    beside = (planes - planes.median(dim=1, keepdim=True).values).abs()
    deviation = 1.4826 * beside.median(dim=1, keepdim=True).values
    near = beside <= _NEAR * deviation
    count = near.sum(dim=1, keepdim=True)
    mean = (planes * near).sum(dim=1, keepdim=True) / count
    return torch.where(mean < -_SURELY * deviation / count.sqrt(), mean, 0)[..., None]


def check_psf(psf: Measurement, values: Tensor) -> list[str]:
    """Refuse what cannot be a PSF; sentences to show of what could be better.

    `values` are those of the developed PSF as they are used, (channels, height, width).

    Raises
    ------
    DataError
        If it shows nothing above its background.
    """
    _check_light(psf, values)
    return _psf_warnings(psf, values)


def _widened(
    psf: Measurement, values: Tensor, measurement: Measurement
) -> tuple[Tensor, tuple[str, ...]]:
    """The PSF with dark pixels where it is smaller than the sensor, without where larger.

    Also what was done; the zero shift stays in the middle.
    """
    sides: list[tuple[int, int]] = []
    done = []
    for axis, what in ((-2, "rows"), (-1, "columns")):
        have, need = values.shape[axis], measurement.size[axis]
        before, after = _sides(values, axis, need)
        sides.append((before - have // 2, after - (have - have // 2)))
        change = before + after - have
        if change > 0:
            done.append(f"{change} dark {what} are added")
        elif change < 0:
            done.append(f"{-change} {what} without light are cut off")
    kept = nnf.pad(values, (*sides[1], *sides[0])) if done else values
    beyond = [kept.shape[axis] > measurement.size[axis] for axis in (-2, -1)]
    text = " and ".join(done) + " around the PSF's middle" if done else ""
    if any(beyond) and not all(beyond):
        text = f"{text}, and it" if text else "the PSF"
        text += " is taken as extended"
    return kept, (f"{sizes_text(psf, measurement)}: {text}",) if text else ()


def _sides(values: Tensor, axis: int, need: int) -> tuple[int, int]:
    """Pixels before the zero shift, and from it on, that are to be kept along an axis."""
    have = values.shape[axis]
    if have <= need:
        return need // 2, need - need // 2
    lit = (values.amax(dim=(0, -1 if axis == -2 else -2)) > 0).nonzero().flatten()
    before = max(need // 2, have // 2 - int(lit[0]))
    after = max(need - need // 2, int(lit[-1]) + 1 - have // 2)
    if after not in (before, before + 1):
        before = after = max(before, after)
    return (before, after) if before + after < have else (have // 2, have - have // 2)


def sizes_text(psf: Measurement, measurement: Measurement) -> str:
    """The sizes of both, for messages."""
    return (
        f"the PSF {psf.source} has {psf.size_text} pixels, {measurement.source} has "
        f"{measurement.size_text}"
    )


def _check_colours(psf: Measurement, measurement: Measurement) -> None:
    if psf.mosaic and measurement.mosaic and psf.mosaic != measurement.mosaic:
        raise DataError(
            f"the PSF {psf.source} has the colour mosaic {psf.mosaic}, but "
            f"{measurement.source} has {measurement.mosaic}: take both with the same readout"
        )
    if psf.channels in (("grey",), measurement.channels):
        return
    names, need = ", ".join(psf.channels), ", ".join(measurement.channels)
    remedy = (
        "take grey of both (--channels grey)"
        if measurement.channels == ("grey",)
        else "choose channels that both have (--channels)"
    )
    raise DataError(
        f"the PSF {psf.source} has the channels {names}, but "
        f"{measurement.source} has {need}: {remedy}. A grey PSF serves any channel"
    )


def _scale_that_fits(psf: Measurement, measurement: Measurement, geometry: PsfGeometry) -> int:
    """How many PSF pixels in each direction make one of the measurement."""
    scale, extended = geometry.scale, geometry.extended
    if scale is not None and scale < 1:
        raise OptionError(f"--psf-scale {scale}: a whole number from 1 on would be accepted")
    height, width = psf.values.shape[-2:]
    rows, columns = measurement.values.shape[-2:]
    sizes = sizes_text(psf, measurement)
    same = (height, width) == (rows, columns)
    if not same and (height, width) == (columns, rows):
        raise DataError(f"{sizes}: one of them is turned by 90°. Turn it back")
    smaller = (height < rows, width < columns)
    if geometry.partial:
        return scale or 1
    if all(smaller) or (any(smaller) and scale is not None):
        raise DataError(
            f"{sizes}: a PSF must be at least as large in one direction, and without --psf-scale. "
            "Use files of one size (the same --bin and the same cut), or an extended or finer PSF; "
            "--psf-scale 1 where its dark sides were cut off"
        )
    if any(smaller):
        return 1
    fitting = height // rows
    finer = (height // fitting, width // fitting) == (rows, columns)
    if extended:
        factor = scale or 1
        binned = height // factor, width // factor
        if same:
            raise DataError(f"{sizes}: that is not extended. Leave out --psf-extent wide")
        if binned == (rows, columns) or binned[0] < rows or binned[1] < columns:
            raise DataError(
                f"{sizes}: with --psf-scale {factor} the PSF becomes {binned[0]}×{binned[1]}, "
                "which is not extended. Leave out --psf-extent wide or --psf-scale"
            )
        return factor
    if scale is not None:
        if (height // scale, width // scale) == (rows, columns):
            return scale
        if same:
            remedy = "leave it out"
        else:
            remedy = f"--psf-scale {fitting} would fit" if finer else "no scale would fit"
            remedy += ", or --psf-extent wide takes the PSF as extended"
        raise DataError(
            f"{sizes}: with --psf-scale {scale} the PSF becomes "
            f"{height // scale}×{width // scale}. Instead, {remedy}"
        )
    if height == rows or width == columns:
        return 1
    reading = f"(--psf-scale {fitting})" if finer else "(--psf-scale N; no N fits these sizes)"
    raise DataError(
        f"{sizes}. A larger PSF is either finer {reading}, or extended: same pixels, and "
        "light beyond the sensor too (--psf-extent wide). Say which"
    )


def _check_light(psf: Measurement, values: Tensor) -> None:
    """Refuse a PSF without light in it.

    Light is either a peak of more than 8σ above the median (σ from the median absolute
    deviation, or from all but the brightest percent where that is more), or structure larger
    than a pixel: the mean square difference of neighbours, which is twice the variance for
    noise alone, is less than half of that. Dense masks have no outstanding peak, fine ones no
    smooth structure; noise has neither.
    """
    plane = values.mean(dim=0)
    flat = plane.flatten()
    peak = float(flat.max())
    variance = float(flat.var(correction=0))
    steps = [plane.diff(dim=d).square().mean() for d in (0, 1) if plane.shape[d] > 1]
    roughness = float(sum(steps)) / max(1, len(steps)) / 2
    if peak > 0 and variance > 0 and roughness < _NOISE_RATIO * variance:
        return  # Structured; sorting all values would take longer than a Wiener filter.
    median = flat.median()
    deviation = 1.4826 * float((flat - median).abs().median())
    count = max(1, int(0.99 * flat.numel()))
    faint = flat.sort().values[:count]
    noise = max(deviation, float(faint.std(correction=0)))
    if not (peak > 0 and peak - float(median) > _PEAK_SIGMAS * noise):
        raise DataError(
            f"the PSF {psf.source} shows nothing above its background: its peak is {peak:g}, "
            f"its median {float(median):g}, with noise of {noise:.2g}. A picture of a point "
            "source is needed; check the file, the exposure and the black level (--black)"
        )


def _psf_warnings(psf: Measurement, values: Tensor) -> list[str]:
    """Sentences, one for each warning of a PSF alone; `values` are on the pixels that are used."""
    texts = []
    saturated = 1 - int(psf.valid.count_nonzero()) / psf.valid.numel()
    if saturated > _SATURATED_FRACTION:
        texts.append(
            f"{100 * saturated:.2g} % of the PSF {psf.source} is saturated, and its peaks are "
            "cut off there: a shorter exposure of the point source gives a better picture"
        )
    # Where no light falls, half of the noise is negative.
    noise = 2 * float(squares(values.clamp(max=0)).sum() / squares(values).sum())
    if noise > _NOISY:
        texts.append(
            f"{percent(noise)} of the power of the PSF {psf.source} is noise, or its black level "
            "is too high: expose the point source longer, or take the mean of many frames (nolens "
            "calibrate)"
        )
    if not black_is_known(psf, values):
        corner, peak = darkest_corner(values), float(values.max())
        texts.append(
            f"the darkest corner of the PSF {psf.source} is {corner:.3g}, "
            f"{100 * corner / peak:.2g} % of its peak: if no light falls there, this is a black "
            "level that the file does not state: subtract it (with a dark frame; reconstruct, "
            "measure psf and calibrate import also take --black auto)"
        )
    return texts


def _pair_warnings(psf: Measurement, values: Tensor, measurement: Measurement) -> list[str]:
    """Sentences, one for each warning of a PSF beside a measurement; as `_psf_warnings`."""
    texts = []
    saturated = float((~measurement.valid).float().mean())
    if saturated > _SATURATED_MEASUREMENT:
        texts.append(
            f"{100 * saturated:.2g} % of {measurement.source} cannot be used, as it is "
            "saturated or has no flat field, and is left out of the fit: a shorter exposure "
            "gives a better picture"
        )
    edge = edge_warning(psf.source, values, measurement.size)
    if edge is not None and black_is_known(psf, values):
        texts.append(edge)
    if has_finer_detail(measurement.values, values):
        texts.append(
            f"{measurement.source} has finer detail than the PSF {psf.source}, and "
            "a measurement is the scene blurred by the PSF: the two files may be swapped"
        )
    return texts


def black_is_known(psf: Measurement, values: Tensor) -> bool:
    """Whether the black level of a PSF is known, or its darkest corner says that it is 0."""
    if psf.black_stated or min(values.shape[-2:]) < _HAS_CORNERS:
        return True
    return darkest_corner(values) <= _CORNER_FRACTION * float(values.max())


def reaches_edges(values: Tensor, sensor: tuple[int, int]) -> bool:
    """Whether a PSF goes on beyond the sensor, and is not known there.

    Its values are (channels, height, width); where they are larger than the measurement's
    (height, width), `sensor`, the PSF is known beyond.
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
    return bool(edges) and float(torch.cat(edges).mean()) > _EDGE_FRACTION * float(plane.mean())


def edge_warning(source: str, values: Tensor, sensor: tuple[int, int]) -> str | None:
    """Warn of a PSF that goes on beyond the sensor, as `reaches_edges` says; None otherwise."""
    if not reaches_edges(values, sensor):
        return None
    return (
        f"the PSF {source} has light up to the sensor's edges: what falls beyond them is missing "
        "from it, and pictures come out poor, depths wrong. Give an extended PSF "
        "(nolens calibrate stitch or extrapolate; of a simulated camera nolens psf --pixels) with "
        "--psf-extent wide and --support; an aperture on the mask keeps such light out"
    )


def extrapolation_note(
    source: str, values: Tensor, sensor: tuple[int, int], folder: str
) -> str | None:
    """What continues a PSF of a camera's folder beyond the sensor; None where it ends before."""
    if not reaches_edges(values, sensor):
        return None
    return (
        f"{source} has light up to the sensor's edges, and what falls beyond them is missing: "
        f"nolens calibrate extrapolate {folder} --support HEIGHTxWIDTH continues it (nolens "
        "calibrate plan gives the support); captures at angles do it better (nolens calibrate "
        "stitch)"
    )


def has_finer_detail(measured: Tensor, psf: Tensor) -> bool:
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
