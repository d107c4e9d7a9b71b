"""The exposure times of a capture: those asked for, or one that fits."""

import math

from nolens.capture import CameraSource, Levels, Limits, exposure_for
from nolens.jobs.capturing.options import CaptureOptions
from nolens.jobs.reporter import Reporter

_LONGEST_S = 1.0
"""That is tried unasked."""
_FIRST_S = 0.01
_TRIES = 12
_DIGITS = 2


def exposures(
    source: CameraSource, options: CaptureOptions, reporter: Reporter
) -> tuple[float, ...]:
    """Exposure times of the frames of one round, the shortest first; NaN where none can be set.

    Parameters
    ----------
    source
        The open camera.
    options
        They say the first exposure time, and how many there are.
    reporter
        Sees the tries.

    Raises
    ------
    OptionError
        If one of them, or the gain, is beyond the camera.
    CameraError
        If the camera gives no frames.
    """
    limits = source.limits
    if limits is None:
        return (math.nan,)
    if options.exposure is not None:
        first_s = options.exposure.s
        limits.check(first_s, options.gain)
    else:
        first_s = _found(source, limits, options, reporter)
    times = tuple(first_s * options.factor**number for number in range(options.bracket))
    limits.check(times[-1], options.gain)
    return times


def _found(
    source: CameraSource, limits: Limits, options: CaptureOptions, reporter: Reporter
) -> float:
    """An exposure time that fits what the camera sees now."""
    tried = Limits((limits.exposure_s[0], min(limits.exposure_s[1], _LONGEST_S)), limits.gain)
    exposure_s = min(max(_FIRST_S, tried.exposure_s[0]), tried.exposure_s[1])
    for number in range(_TRIES):
        reporter.advance("exposure", number / _TRIES)
        source.set(exposure_s=exposure_s, gain=options.gain)
        levels = Levels.of(source.shot().frame)
        better_s = exposure_for(levels, exposure_s, tried, every_pixel=options.kind == "psf")
        if better_s == exposure_s:
            break
        exposure_s = better_s
    reporter.advance("exposure", 1.0)
    if exposure_s >= _LONGEST_S:
        reporter.note(f"exposed {_LONGEST_S:g} s, the longest unasked: more light, or --exposure")
    digits = _DIGITS - 1 - math.floor(math.log10(exposure_s))
    return min(max(round(exposure_s, digits), tried.exposure_s[0]), tried.exposure_s[1])
