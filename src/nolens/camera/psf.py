"""A point spread function that fits a measurement."""

from dataclasses import dataclass

from torch import Tensor

from nolens.camera.measurement import Measurement, bin_mean, darkest_corner
from nolens.errors import DataError, OptionError

_PEAK_SIGMAS = 8.0
_NOISE_RATIO = 0.5
_SATURATED_SHARE = 1e-3
_CORNER_SHARE = 1e-2
_HAS_CORNERS = 60  # Below, the corners' pixels reach into the middle half of the PSF.


@dataclass(frozen=True)
class PreparedPsf:
    """A PSF on the pixels of a measurement, and what a person should know about it.

    Attributes
    ----------
    values
        float32, (channels, height, width), not negative; one channel serves all.
    warnings
        Sentences to show, one for each doubt.
    """

    values: Tensor
    warnings: tuple[str, ...]


def prepare_psf(
    psf: Measurement, measurement: Measurement, *, scale: int | None = None, wider: bool = False
) -> PreparedPsf:
    """Make a PSF fit a measurement, or say why it does not.

    Parameters
    ----------
    psf
        The developed PSF: of the measurement's size, or larger.
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
        If size, channels or mosaic do not fit, or the PSF shows nothing above its background.
    OptionError
        If both `scale` and `wider` are given, or `scale` is less than 1.
    """
    _check_colours(psf, measurement)
    values = psf.values
    factor = _scale_that_fits(psf, measurement, scale, wider)
    if factor > 1:
        values = bin_mean(values, factor)
    _check_light(psf, values)
    return PreparedPsf(values.clamp_min(0.0), tuple(_doubts(psf, values)))


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
            "--psf-scale and --psf-wider are two readings of a larger PSF: finer pixels, or "
            "the same pixels on a wider area. Give one of them"
        )
    if scale is not None and scale < 1:
        raise OptionError(f"--psf-scale {scale}: a whole number from 1 on would be accepted")
    height, width = psf.values.shape[-2:]
    rows, columns = measurement.values.shape[-2:]
    sizes = (
        f"the PSF {psf.source} has {psf.size_text} pixels, the measurement "
        f"{measurement.source} has {measurement.size_text}"
    )
    if height < rows or width < columns:
        raise DataError(
            f"{sizes}: a PSF must be at least as large in both directions. Use files of one "
            "size (the same --bin and the same cut), or a wider or finer PSF"
        )
    same = (height, width) == (rows, columns)
    fitting = height // rows
    finer = (height // fitting, width // fitting) == (rows, columns)
    if wider:
        if same:
            raise DataError(f"{sizes}: that is not wider. Leave out --psf-wider")
        return 1
    if scale is not None:
        if (height // scale, width // scale) == (rows, columns):
            return scale
        if same:
            remedy = "leave it out"
        else:
            remedy = f"--psf-scale {fitting} would fit" if finer else "no scale would fit"
            remedy += ", or --psf-wider takes the PSF as a wider view"
        raise DataError(
            f"{sizes}: with --psf-scale {scale} the PSF becomes "
            f"{height // scale}×{width // scale}. Instead, {remedy}"
        )
    if same:
        return 1
    reading = f"(--psf-scale {fitting})" if finer else "(--psf-scale N; no N fits these sizes)"
    raise DataError(
        f"{sizes}. A larger PSF is either finer {reading}, or it is wider: same pixels, and "
        "light that falls beside the sensor too (--psf-wider). Say which"
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
            f"its median {float(median):g}, with noise of {noise:.2g}. A picture of a point of "
            "light is needed; check the file, the exposure and the black level (--black)"
        )


def _doubts(psf: Measurement, values: Tensor) -> list[str]:
    doubts = []
    saturated = float((~psf.valid).float().mean())
    if saturated > _SATURATED_SHARE:
        doubts.append(
            f"{100 * saturated:.2g} % of the PSF {psf.source} is saturated, and its peaks are "
            "cut off there: a shorter exposure of the point of light gives a better picture"
        )
    if psf.black_stated or min(values.shape[-2:]) < _HAS_CORNERS:
        return doubts
    corner, peak = darkest_corner(values), float(values.max())
    if corner > _CORNER_SHARE * peak:
        doubts.append(
            f"the darkest corner of the PSF {psf.source} is {corner:.3g}, {100 * corner / peak:.2g}"
            " % of its peak: if no light falls there, this is a black level that the file does "
            "not state, and --black auto subtracts it"
        )
    return doubts
