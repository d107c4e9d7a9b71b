"""A point spread function that fits a measurement."""

from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.camera.measurement import Measurement, bin_mean
from nolens.camera.psf_warnings import pair_warnings, psf_warnings
from nolens.errors import DataError, OptionError

_PEAK_SIGMAS = 8.0
_NOISE_RATIO = 0.5


@dataclass(frozen=True)
class PreparedPsf:
    """A PSF on the pixels of a measurement, and what a person should know about it.

    Attributes
    ----------
    values
        float32, (channels, height, width), not negative; one channel serves all.
    warnings
        Sentences to show, one for each warning.
    notes
        Sentences that say what was done to make it fit.
    """

    values: Tensor
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()


def prepare_psf(
    psf: Measurement, measurement: Measurement, *, scale: int | None = None, wider: bool = False
) -> PreparedPsf:
    """Make a PSF fit a measurement, or say why it does not.

    Parameters
    ----------
    psf
        The developed PSF: of the measurement's size, or larger. Where it is smaller in one
        direction only, it is dark there around its middle.
    measurement
        The measurement it is for.
    scale
        The PSF has `scale` times as many pixels in each direction on the same area: N×N of
        them are averaged into one.
    wider
        The PSF has the measurement's pixels, and more of them around: it is kept as it is.

    Raises
    ------
    DataError
        If size, channels or mosaic do not fit, the PSF shows nothing above its background, or
        both hold the same.
    OptionError
        If both `scale` and `wider` are given, or `scale` is less than 1.
    """
    _check_colours(psf, measurement)
    values = psf.values
    factor = _scale_that_fits(psf, measurement, scale, wider)
    if factor > 1:
        values = bin_mean(values, factor)
    warnings = check_psf(psf, values)
    if torch.equal(values, measurement.values):
        raise DataError(
            f"the measurement {measurement.source} and the PSF {psf.source} hold the same values: "
            "give what the sensor measured of the scene, and what it measured of a point source"
        )
    warnings += pair_warnings(psf, values, measurement)
    values, notes = _widened(psf, values.clamp_min(0.0), measurement)
    return PreparedPsf(values, tuple(warnings), notes)


def check_psf(psf: Measurement, values: Tensor) -> list[str]:
    """Refuse what cannot be a PSF; sentences to show of what could be better.

    Parameters
    ----------
    psf
        The developed PSF.
    values
        Its values as they are used, (channels, height, width).

    Raises
    ------
    DataError
        If it shows nothing above its background.
    """
    _check_light(psf, values)
    return psf_warnings(psf, values)


def _widened(
    psf: Measurement, values: Tensor, measurement: Measurement
) -> tuple[Tensor, tuple[str, ...]]:
    """The PSF with dark pixels around it where it is smaller than the sensor; what was done."""
    sizes = (
        f"the PSF {psf.source} has {psf.size_text} pixels, the measurement {measurement.source} "
        f"has {measurement.size_text}"
    )
    sides = []
    for have, need in zip(values.shape[-2:], measurement.size, strict=True):
        before = max(0, need // 2 - have // 2)  # The zero shift stays in the middle.
        sides.append((before, max(0, need - have - before)))
    if not any(map(any, sides)):
        rows, columns = (values.shape[-2 + axis] == measurement.size[axis] for axis in (0, 1))
        return values, () if rows == columns else (f"{sizes}: the PSF is taken as extended",)
    added, what = (sum(sides[0]), "rows") if any(sides[0]) else (sum(sides[1]), "columns")
    note = f"{sizes}: {added} dark {what} are added around the PSF's middle"
    return nnf.pad(values, (*sides[1], *sides[0])), (note,)


def _check_colours(psf: Measurement, measurement: Measurement) -> None:
    if psf.mosaic and measurement.mosaic and psf.mosaic != measurement.mosaic:
        raise DataError(
            f"the PSF {psf.source} has the colour mosaic {psf.mosaic}, but the measurement "
            f"{measurement.source} has {measurement.mosaic}: take both with the same readout"
        )
    if psf.channels in (("grey",), measurement.channels):
        return
    given, need = ", ".join(psf.channels), ", ".join(measurement.channels)
    remedy = (
        "take grey of both (--channels grey)"
        if measurement.channels == ("grey",)
        else "choose channels that both have (--channels)"
    )
    raise DataError(
        f"the PSF {psf.source} has the channels {given}, but the measurement "
        f"{measurement.source} has {need}: {remedy}. A grey PSF serves any channel"
    )


def _scale_that_fits(
    psf: Measurement, measurement: Measurement, scale: int | None, wider: bool
) -> int:
    """How many PSF pixels in each direction make one of the measurement."""
    if scale is not None and wider:
        raise OptionError(
            "--psf-scale and --psf-extent wide are two readings of a larger PSF: finer pixels, or "
            "the same pixels on a larger area. Give one of them"
        )
    if scale is not None and scale < 1:
        raise OptionError(f"--psf-scale {scale}: a whole number from 1 on would be accepted")
    height, width = psf.values.shape[-2:]
    rows, columns = measurement.values.shape[-2:]
    sizes = (
        f"the PSF {psf.source} has {psf.size_text} pixels, the measurement "
        f"{measurement.source} has {measurement.size_text}"
    )
    same = (height, width) == (rows, columns)
    if not same and (height, width) == (columns, rows):
        raise DataError(f"{sizes}: one of them is turned by 90°. Turn it back")
    smaller = (height < rows, width < columns)
    if all(smaller) or (any(smaller) and scale is not None):
        raise DataError(
            f"{sizes}: a PSF must be at least as large in one direction, and without --psf-scale. "
            "Use files of one size (the same --bin and the same cut), or an extended or finer PSF"
        )
    if any(smaller):
        return 1
    fitting = height // rows
    finer = (height // fitting, width // fitting) == (rows, columns)
    if wider:
        if same:
            raise DataError(f"{sizes}: that is not extended. Leave out --psf-extent wide")
        return 1
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
    kept = max(1, int(0.99 * flat.numel()))
    faint = flat.sort().values[:kept]
    noise = max(deviation, float(faint.std(correction=0)))
    if not (peak > 0 and peak - float(median) > _PEAK_SIGMAS * noise):
        raise DataError(
            f"the PSF {psf.source} shows nothing above its background: its peak is {peak:g}, "
            f"its median {float(median):g}, with noise of {noise:.2g}. A picture of a point "
            "source is needed; check the file, the exposure and the black level (--black)"
        )
