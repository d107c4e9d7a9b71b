"""Figures of a point spread function: its lines, pitch, contrast, sparsity and spectrum."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor

from nolens.errors import DataError
from nolens.kernels import fast_length, irfft2, rfft2

_DIRECTIONS_DEG = (0, 90, 180, 270)
"""Directions along which the magnitude is measured: to the right, up, to the left and down."""
_WEDGE_DEG = 10.0
_RING = 0.0025
_NOISE_RING = 0.02
_HIGHEST = 0.5
"""Cycles per pixel: half width of a direction, width of a ring, the same for noise, the limit."""
_CROSS, _NEAR = 2, 16
"""Steps of the transform from an axis that are left out, and from zero up to which they are not."""
_BLOCK = 3
_DARKEST = 0.01
_DEVIATIONS = 2.33
"""Sides of the means, the fraction of them that is darker than the background, and how many
standard deviations below its mean a normal distribution has that fraction."""
_STEP = 0.25
"""Pixels from one value of a profile to the next."""
_BINS = 8192
_FARTHEST = math.sqrt(0.5)
"""Cycles per pixel, of the corners of the spectrum."""
_STRIP = 16
_LEAST_RISE = 0.01
"""Of a second peak, over the lowest value before it: less is chance."""
_FEW = 9
_LEAST_FRACTION = 1e-4
_SMALLEST = 16
_RING_STEPS = 3.0
"""Steps of the transform, half the width of the ring of `spectral_magnitude`."""

_CURVES = (
    "lag_um",
    "autocorrelation",
    "row_autocorrelation",
    "per_mm",
    "magnitude",
    "direction_magnitude",
)


@dataclass(frozen=True)
class _Spectrum:
    """Power of a PSF without its mean, by spatial frequency in cycles per pixel.

    `power` is |F|², half of the plane, float64; `noise_power` the same of white noise on every
    pixel; `background` the level that the PSF stands on; `total` its sum without that.
    """

    power: Tensor
    down: Tensor
    right: Tensor
    shape: tuple[int, int]
    noise_power: float
    background: float = 0.0
    total: float = 1.0

    @classmethod
    def of(cls, pattern: Tensor, noise: float | None) -> "_Spectrum":
        """Transform a PSF (rows, columns) with a standard deviation of every pixel's noise.

        None takes the power that is left at the frequencies, up to half a cycle per pixel, where
        it is least: rings of 0.02 cycles, the lowest of them. PSFs with details finer than two
        pixels have power there too, which counts as noise.
        """
        rows, columns = pattern.shape
        shape, values = (rows, columns), pattern.double()
        power = rfft2((values - values.mean()).contiguous()).abs().square()
        down = torch.fft.fftfreq(rows, dtype=torch.float64)
        right = torch.fft.rfftfreq(columns, dtype=torch.float64)
        spectrum = cls(power, down, right, shape, 0.0)
        if noise is None:
            floor = spectrum._rings(_NOISE_RING, None)[1].min()
        else:
            floor = torch.tensor(noise**2 * rows * columns)
        background = _background_of(pattern, math.sqrt(float(floor) / (rows * columns)))
        total = float((values - background).sum())
        return cls(power, down, right, shape, float(floor), background, total)

    @property
    def pixels(self) -> int:
        """Number of pixels of the PSF."""
        return self.shape[0] * self.shape[1]

    @property
    def noise(self) -> float:
        """Standard deviation of every pixel's noise, in the PSF's unit."""
        return math.sqrt(self.noise_power / self.pixels)

    @property
    def radius(self) -> Tensor:
        """Length of every frequency."""
        return torch.hypot(self.down[:, None], self.right)

    @property
    def weight(self) -> Tensor:
        """How often every column stands in the whole plane."""
        return _column_weights(self.shape[1])

    def magnitude(self, direction_deg: int | None = None) -> tuple[Tensor, Tensor]:
        r"""Frequencies and spectral magnitude :math:`\sqrt{\langle|F|^2\rangle - N}\,/\,F_0`.

        Over rings of 0.0025 cycles per pixel (or two steps of the transform, where that is
        more), without the noise's power N; :math:`F_0` is the PSF's light without its
        background. It is the root mean square over many spots in random places: n of them have
        :math:`1/\sqrt n` of what one has, so it is no modulation transfer. With a direction, only
        what lies within 10° of it counts, but for the axis itself, on which the frame's edges show.
        """
        at, power = self._rings(_RING, direction_deg)
        return at, (power - self.noise_power).clamp_min(0).sqrt() / self.total

    def clear_bands(self) -> tuple[tuple[float, float], ...]:
        """Frequencies, from and to, at which the PSF has more power than noise.

        In cycles per pixel. At their ends Wiener's filter gives half of what it passes
        (`wiener1949`). Gaps and bands of less than 0.02 cycles are passed over.
        """
        at, power = self._rings(_RING, None)
        clear = power >= 2 * self.noise_power
        for value in (False, True):
            for first, last in _runs(clear, value=value):
                ends = first == 0 if value else last == len(at) - 1
                if float(at[last] - at[first]) < _NOISE_RING and not ends:
                    clear[first : last + 1] = not value
        edges = [float(each) for each in at]
        edges[0], edges[-1] = 0.0, _HIGHEST
        return tuple((edges[first], edges[last]) for first, last in _runs(clear, value=True))

    def _rings(self, width: float, direction_deg: int | None) -> tuple[Tensor, Tensor]:
        """Mean frequency and mean power of rings that hold any values."""
        width = max(width, 2 / min(self.shape))
        radius = self.radius
        inside = (radius > 0) & (radius <= _HIGHEST)
        if direction_deg is not None:
            angle = torch.atan2(-self.down[:, None], self.right) * (180 / math.pi)
            # F(-f) is the conjugate of F(f): half of the plane has every direction, modulo 180°.
            off = (angle - direction_deg + 90).remainder(180) - 90
            inside &= off.abs() <= _WEDGE_DEG
            # Frames that do not continue at their edges have a cross of light in their spectrum.
            steps = (self.down[:, None] * self.shape[0], self.right * self.shape[1])
            beside = (steps[0].abs() >= _CROSS) & (steps[1].abs() >= _CROSS)
            inside &= beside | (torch.hypot(*steps) < _NEAR)
        radius, power = radius[inside], (self.power * self.weight)[inside]
        weight = self.weight.expand_as(self.power)[inside]
        # What is left over beyond the last whole ring counts to that.
        last = max(1, round(_HIGHEST / width)) - 1
        ring = (radius / width).long().clamp(max=last)
        count = torch.zeros(last + 1, dtype=torch.float64)
        sums = [count.clone().index_add_(0, ring, each) for each in (radius * weight, power)]
        count.index_add_(0, ring, weight)
        filled = count > 0
        return sums[0][filled] / count[filled], sums[1][filled] / count[filled]


def _runs(clear: Tensor, *, value: bool) -> list[tuple[int, int]]:
    """First and last place of every run of a value."""
    places: list[tuple[int, int]] = []
    for place, each in enumerate(clear.tolist()):
        if each != value:
            continue
        if places and places[-1][1] == place - 1:
            places[-1] = places[-1][0], place
        else:
            places.append((place, place))
    return places


def _column_weights(columns: int) -> Tensor:
    """How often every column of a half spectrum stands in the whole one."""
    weight = torch.full((columns // 2 + 1,), 2.0, dtype=torch.float64)
    weight[0] = 1.0
    if columns % 2 == 0:
        weight[-1] = 1.0
    return weight


def _background_of(pattern: Tensor, noise: float) -> float:
    """Level that the PSF stands on: 1 % of its 3×3 means are darker, but for the noise.

    Of a dark area with noise of some standard deviation, 1 % of the 3×3 means are darker by 2.33
    thirds of it, which are added.
    """
    means = torch.nn.functional.avg_pool2d(pattern[None, None].double(), _BLOCK, 1).flatten()
    darkest = float(means.sort().values[int(_DARKEST * (len(means) - 1))])
    return darkest + _DEVIATIONS * noise / _BLOCK


@dataclass(frozen=True)
class _Autocorrelation:
    """Autocorrelation of a PSF without its mean and without white noise; 1 at zero.

    By distance in pixels (`lag`): `radial`, the mean over all directions, and `row`, along the
    rows, in both directions the same.
    """

    lag: Tensor
    radial: Tensor
    row: Tensor

    @classmethod
    def of(cls, pattern: Tensor, background: float, noise: float) -> "_Autocorrelation":
        r"""Compute it up to a quarter of the frame, every quarter of a pixel.

        .. math:: A(r) = \sum_f P_f\,J_0(2π f r), \qquad A_0(x) = \sum_f P_f \cos(2π f_x x)

        are the band-limited autocorrelation's mean over a circle and its values on a line, without
        rounding to pixels. The frame, without its edge (`trimmed`), stands in zeros: what leaves it
        does not come in again. Of both, what even light of the same mean would have is taken off.
        """
        light = trimmed(pattern.double() - background)
        rows, columns = light.shape
        pixels, extent = rows * columns, min(rows, columns) // 4
        padded = (
            fast_length(rows + extent, of_rows=False),
            fast_length(columns + extent, of_rows=True),
        )
        values = torch.zeros(padded, dtype=torch.float64)
        values[:rows, :columns] = light
        mean = float(values.sum()) / pixels
        power = rfft2(values).abs().square() - noise**2 * pixels
        power = power * _column_weights(padded[1]) / (pixels * padded[0] * padded[1])
        down = torch.fft.fftfreq(padded[0], dtype=torch.float64)
        right = torch.fft.rfftfreq(padded[1], dtype=torch.float64)
        lag = torch.arange(0, extent + _STEP, _STEP, dtype=torch.float64)
        place = (torch.hypot(down[:, None], right) / _FARTHEST * _BINS).flatten()
        lower = place.long()
        fraction = place - lower
        binned = torch.zeros(_BINS + 2, dtype=torch.float64)
        for bins, part in ((lower, 1 - fraction), (lower + 1, fraction)):
            binned.index_add_(0, bins, power.flatten() * part)
        at = torch.arange(_BINS + 2, dtype=torch.float64) * (_FARTHEST / _BINS)
        radial = torch.special.bessel_j0(2 * math.pi * lag[:, None] * at) @ binned
        row = torch.cos(2 * math.pi * lag[:, None] * right) @ power.sum(dim=0)
        # Of the frame, this much still lies over itself: (1 - |x|/columns) (1 - |y|/rows).
        over = 1 - 2 * lag / math.pi * (1 / rows + 1 / columns) + lag**2 / (math.pi * pixels)
        radial, row = radial - mean**2 * over, row - mean**2 * (1 - lag / columns)
        return cls(lag, radial / radial[0], row / row[0])

    def level(self) -> float:
        """Lowest value between the first peak, at zero, and the second.

        Where spots do not touch, that is what chance and the mean that was taken off leave between
        them, and the first peak above it has the shape of one spot's own autocorrelation.
        """
        return float(self.radial[_valley(self.radial)])

    def width(self, profile: Tensor, level: float) -> float | None:
        """Full width of the first peak half way between 1 and a level, in pixels."""
        place = _falls_to(profile, (1 + level) / 2)
        return None if place is None else 2 * _STEP * place

    def pitch(self, profile: Tensor, level: float, *, spread: bool) -> float | None:
        r"""Distance of the second peak of a profile on a level, in pixels; None if it rises < 1 %.

        With `spread`, the neighbours' peak is spread over a circle of radius r, on which it fades
        as :math:`1/\sqrt r`: that is made up for, so that it does not seem nearer.
        """
        above = profile - level
        valley = _valley(profile)
        peak = _second_peak(above, valley)
        rise = float(above[peak] - above[valley])
        if not valley < peak < len(above) - 1 or rise < _LEAST_RISE:
            return None
        if spread:
            above = above * self.lag.sqrt()
            while above[peak + 1] > above[peak] and peak < len(above) - 2:
                peak += 1
        return _STEP * _vertex(above, peak)


def trimmed(light: Tensor) -> Tensor:
    """Leave out up to a sixteenth of the frame on every side, so that it ends where it is dark.

    Spots that the frame's edge cuts through would count as narrower ones.
    """
    for axis in (0, 1):
        lines = light.square().sum(dim=1 - axis)
        strip = max(1, len(lines) // _STRIP)
        first = int(lines[:strip].argmin())
        last = len(lines) - 1 - int(lines.flip(0)[:strip].argmin())
        light = light.narrow(axis, first, last + 1 - first)
    return light


def _falls_to(profile: Tensor, level: float) -> float | None:
    """The first place at which a profile falls below a level, between its values."""
    below = (profile < level).nonzero()
    if len(below) == 0:
        return None
    first = int(below[0])
    before, after = float(profile[first - 1]), float(profile[first])
    return first - 1 + (before - level) / (before - after)


def _valley(profile: Tensor) -> int:
    """The first place below a half after which the profile rises; its end if it does not."""
    below = (profile < 0.5).nonzero()
    start = int(below[0]) if len(below) else 0
    rising = (profile[start + 1 :] > profile[start:-1]).nonzero()
    return start + int(rising[0]) if len(rising) else len(profile) - 1


def _second_peak(profile: Tensor, valley: int) -> int:
    """The highest place of the first peak after the valley.

    Farther neighbours can make a higher peak: the first one of at least half the height counts.
    """
    rest = profile[valley:]
    high = rest >= (rest.min() + rest.max()) / 2
    start = int(high.nonzero()[0])
    ends = (~high[start:]).nonzero()
    length = int(ends[0]) if len(ends) else len(rest) - start
    return valley + start + int(rest[start : start + length].argmax())


def _vertex(profile: Tensor, peak: int) -> float:
    """Top of the parabola through a peak and its neighbours."""
    left, top, right = (float(profile[peak + step]) for step in (-1, 0, 1))
    return peak + (left - right) / (2 * (left - 2 * top + right))


def clipped_pixels(pattern: Tensor) -> int:
    """Pixels of a PSF (rows, columns) that have the very largest value, if they seem clipped.

    Tops that happen to be of the same height are one thing, level tops another: 0 where hardly any
    lie side by side.
    """
    top = pattern == pattern.max()
    beside = int((top[1:] & top[:-1]).sum() + (top[:, 1:] & top[:, :-1]).sum())
    return int(top.sum()) if beside > max(_FEW, _LEAST_FRACTION * pattern.numel()) else 0


@dataclass(frozen=True)
class PsfFigures:
    """How fine, how dense and how clear a PSF is.

    Parameters
    ----------
    pixel_um
        Pitch of its pixels.
    fwhm_um
        Full width of the autocorrelation, all directions averaged, half way between its peak and
        the lowest value before the second peak: that of one spot, where spots do not touch.
    fwhm_over_mean_um
        The same half way between the peak and zero, the mean taken off, as
        `nolens.evaluate.pattern_figures` has it.
    row_fwhm_um
        `fwhm_um` along the rows alone, the one line that the paper draws.
    line_width_um
        `fwhm_um` / √2: of a line or spot with a Gaussian profile (`uvimprint`).
    pitch_um, row_pitch_um
        From the first to the second peak of the autocorrelation, in all directions and along the
        rows; None where there is no second peak.
    background_fraction
        Fraction of the light that lies evenly under the PSF (see `_background_of`).
    contrast
        Standard deviation over mean (`peli1990`), the noise's fraction taken off.
    sparsity
        Fraction of the area without light, see `nolens.evaluate.sparsity`; noise taken off.
    noise
        Standard deviation of a pixel's noise, in the PSF's unit.
    noise_known
        Whether that was given; otherwise it is the power at the frequencies where it is least.
    noise_magnitude
        What this noise is as spectral magnitude.
    clear_bands_per_mm
        Spatial frequencies, from and to, at which the PSF has more power than noise, up to that of
        two pixels; gaps and bands of less than 0.02 cycles per pixel are passed over.
    usable_per_mm
        End of the first of these bands, from which on the PSF sinks into its noise; 0 where there
        is none.
    line_per_mm
        Frequency of which half a period is a line's width.
    lowest_magnitude
        Smallest magnitude, all directions averaged, up to `line_per_mm`.
    line_deg, usable_deg
        Angles in the scene that are as wide on the sensor as a line, and as half a period of
        `usable_per_mm`; None without a reduced thickness.
    lag_um, autocorrelation, row_autocorrelation
        Autocorrelation without the mean by distance, 1 at zero.
    level
        Of its lowest value before the second peak.
    per_mm, magnitude
        Spectral magnitude over all directions by spatial frequency: root mean square of the
        spectrum over rings, of the light without its background. It scales with one over the root
        of the number of spots, so it is no modulation transfer.
    direction_magnitude
        For 0, 90, 180 and 270°, pairs of frequency and magnitude. A real PSF has the same
        spectrum at 0 and 180°, whatever it is.
    """

    pixel_um: float
    fwhm_um: float
    fwhm_over_mean_um: float
    row_fwhm_um: float | None
    line_width_um: float
    pitch_um: float | None
    row_pitch_um: float | None
    background_fraction: float
    contrast: float
    sparsity: float
    noise: float
    noise_known: bool
    noise_magnitude: float
    clear_bands_per_mm: tuple[tuple[float, float], ...]
    usable_per_mm: float
    line_per_mm: float
    lowest_magnitude: float
    line_deg: float | None
    usable_deg: float | None
    lag_um: tuple[float, ...]
    autocorrelation: tuple[float, ...]
    row_autocorrelation: tuple[float, ...]
    level: float
    per_mm: tuple[float, ...]
    magnitude: tuple[float, ...]
    direction_magnitude: dict[int, tuple[tuple[float, ...], tuple[float, ...]]]

    @property
    def figures(self) -> dict[str, Any]:
        """All figures by name, the curves last."""
        named = asdict(self)
        curves = {name: named.pop(name) for name in _CURVES}
        return {**named, "curves": curves}

    def warnings(self, source: str) -> list[str]:
        """What of the PSF from a source is not known, or could be finer."""
        texts = []
        if self.pitch_um is None:
            texts.append(
                f"the autocorrelation of the PSF {source} has no second peak within a quarter of "
                "the frame: its pitch is not known"
            )
        if self.line_width_um < 2 * self.pixel_um:
            texts.append(
                f"the lines of the PSF {source} are {self.line_width_um:.3g} µm wide, less than "
                "two pixels: smaller pixels or a smaller --bin would tell more"
            )
        return texts


def psf_figures(
    psf: Tensor, pixel_um: float, *, reduced_um: float | None = None, noise: float | None = None
) -> PsfFigures:
    r"""Measure a PSF (`uvimprint`, fig. 5).

    The light's angle in the scene is its length on the sensor over the reduced thickness
    :math:`D = Σ t/n` of what lies behind the mask.

    Parameters
    ----------
    psf
        (rows, columns), linear, without black level, in any unit.
    pixel_um
        Pitch of its pixels.
    reduced_um
        D; None: angles are left out.
    noise
        Standard deviation of a pixel's noise; None has it estimated, see `_Spectrum.of`.

    Raises
    ------
    DataError
        If the PSF is dark, even or all noise, smaller than 16 pixels, or its lines are wider than
        half of it.
    """
    if min(psf.shape) < _SMALLEST:
        raise DataError(
            f"a PSF of {psf.shape[0]}×{psf.shape[1]} pixels is too small to measure: "
            f"{_SMALLEST}×{_SMALLEST} at least"
        )
    mean = float(psf.double().mean())
    if not mean > 0:
        raise DataError("the PSF is dark: it has no light to measure")
    spectrum = _Spectrum.of(psf, noise)
    variance = float((spectrum.power * spectrum.weight).sum()) / spectrum.pixels**2
    if not variance > 1e-12 * mean**2:
        raise DataError("the PSF is even: it has no lines to measure")
    if not variance > spectrum.noise**2 or not spectrum.total > 0:
        raise DataError(
            f"the PSF varies by {math.sqrt(variance):.4g}, no more than its noise of "
            f"{spectrum.noise:.4g}: it has no lines to measure"
        )
    variance -= spectrum.noise**2
    correlation = _Autocorrelation.of(psf, spectrum.background, spectrum.noise)
    level = correlation.level()
    width, over_mean = (
        correlation.width(correlation.radial, level),
        correlation.width(correlation.radial, 0.0),
    )
    if width is None or over_mean is None:
        raise DataError("the PSF is too small to measure: its lines are wider than half of it")
    line_um = width * pixel_um / math.sqrt(2)
    pitches = [
        correlation.pitch(profile, level, spread=spread)
        for profile, spread in ((correlation.radial, True), (correlation.row, False))
    ]
    row = correlation.width(correlation.row, level)
    to_mm = 1e3 / pixel_um
    at, magnitude = spectrum.magnitude()
    line_per_mm = 500 / line_um
    below = magnitude[at * to_mm <= line_per_mm]
    bands = tuple((low * to_mm, high * to_mm) for low, high in spectrum.clear_bands())
    usable = bands[0][1] if bands else 0.0
    directions = {angle: spectrum.magnitude(angle) for angle in _DIRECTIONS_DEG}
    return PsfFigures(
        pixel_um=pixel_um,
        fwhm_um=width * pixel_um,
        fwhm_over_mean_um=over_mean * pixel_um,
        row_fwhm_um=None if row is None else row * pixel_um,
        line_width_um=line_um,
        pitch_um=None if pitches[0] is None else pitches[0] * pixel_um,
        row_pitch_um=None if pitches[1] is None else pitches[1] * pixel_um,
        background_fraction=spectrum.background / mean,
        contrast=math.sqrt(variance) / mean,
        sparsity=sparsity(psf, spectrum.noise),
        noise=spectrum.noise,
        noise_known=noise is not None,
        noise_magnitude=math.sqrt(spectrum.noise_power) / spectrum.total,
        clear_bands_per_mm=bands,
        usable_per_mm=usable,
        line_per_mm=line_per_mm,
        lowest_magnitude=float(below.min()) if len(below) else float(magnitude[0]),
        line_deg=_angle_deg(line_um, reduced_um),
        usable_deg=_angle_deg(500 / usable, reduced_um) if usable else None,
        lag_um=_floats(correlation.lag * pixel_um),
        autocorrelation=_floats(correlation.radial),
        row_autocorrelation=_floats(correlation.row),
        level=level,
        per_mm=_floats(at * to_mm),
        magnitude=_floats(magnitude),
        direction_magnitude={
            angle: (_floats(each * to_mm), _floats(values))
            for angle, (each, values) in directions.items()
        },
    )


def _angle_deg(length_um: float, reduced_um: float | None) -> float | None:
    return None if reduced_um is None else math.degrees(math.atan(length_um / reduced_um))


def _floats(values: Tensor) -> tuple[float, ...]:
    return tuple(values.tolist())


@dataclass(frozen=True)
class PatternFigures:
    """What the autocorrelation of a PSF shows.

    Parameters
    ----------
    width_um
        Full width at half maximum of the autocorrelation. A line of the PSF with a Gaussian
        profile is √2 thinner.
    pitch_um
        From its first peak, at zero, to the second: the mean distance of neighbouring lines.
    """

    width_um: float
    pitch_um: float


def pattern_figures(psf: Tensor, pixel_um: float) -> PatternFigures:
    r"""Width and pitch of a PSF from its autocorrelation (`uvimprint`, fig. 5b).

    The mean is subtracted; the autocorrelation :math:`F^{-1}|F(p - \bar p)|^2` of the whole
    frame is averaged over all directions, where the paper draws one line through it. The second
    peak is the highest after the first minimum, refined by a parabola.

    Parameters
    ----------
    psf
        (height, width), in any unit.
    pixel_um
        Pitch of its pixels.

    Raises
    ------
    DataError
        If the PSF is even, or too small to have a second peak.
    """
    rows, columns = psf.shape
    spectrum = rfft2((psf - psf.double().mean().to(psf.dtype)).contiguous())
    correlation = irfft2(spectrum.abs().square().to(spectrum.dtype), (rows, columns))
    if not float(correlation[0, 0]) > 0:
        raise DataError("the PSF is even: it has no lines to measure")
    profile = _radial(correlation)
    half = _falls_to(profile, 0.5)
    if half is None:
        raise DataError("the PSF is too small to measure: its lines are wider than half of it")
    valley = _valley(profile)
    peak = _second_peak(profile, valley)
    if not valley < peak < len(profile) - 1:
        raise DataError("the PSF is too small to measure: its autocorrelation has no second peak")
    pitch_um = _vertex(profile, peak) * pixel_um
    return PatternFigures(width_um=2 * half * pixel_um, pitch_um=pitch_um)


def _radial(correlation: Tensor) -> Tensor:
    """Mean over all directions by distance in pixels, up to a quarter of the frame; 1 at zero."""
    extent = min(correlation.shape) // 4
    lags = [torch.fft.fftfreq(n, 1 / n, dtype=torch.float64) for n in correlation.shape]
    near = [(lag.abs() <= extent + 1).nonzero().flatten() for lag in lags]
    distance = torch.hypot(
        lags[0][near[0]][:, None].expand(-1, len(near[1])),
        lags[1][near[1]].expand(len(near[0]), -1),
    ).flatten()
    values = correlation[near[0]][:, near[1]].double().flatten()
    # Every value counts in the two rings it lies between, by its distance to them.
    inner = distance.floor().long()
    fraction = distance - inner
    length = int(inner.max()) + 2
    total, weight = torch.zeros(length).double(), torch.zeros(length).double()
    for ring, part in ((inner, 1 - fraction), (inner + 1, fraction)):
        total.index_add_(0, ring, values * part)
        weight.index_add_(0, ring, part)
    profile = (total / weight.clamp_min(1e-12))[: extent + 1]
    return profile / profile[0]


def spectral_magnitude(pattern: Tensor, pixel_um: float, per_mm: float) -> float:
    r"""Spectral magnitude of one square millimetre of a PSF at a spatial frequency.

    :math:`\sqrt{a\,\langle|\hat p_f|^2\rangle}\,/\,\hat p_0` over a ring of frequencies, with a the
    PSF's area in mm². A PSF of random spots carries contrast in proportion to
    :math:`1/\sqrt a`; for the area of one mm² it is the same whatever part is looked at. It is no
    modulation transfer, which is 1 at zero frequency: a mask with four times as many spots to the
    mm² has half of it.

    Parameters
    ----------
    pattern
        (rows, columns), in any unit; its mean is taken off before it is transformed.
    pixel_um
        Pitch of its pixels.
    per_mm
        The frequency.

    Raises
    ------
    DataError
        If the PSF is dark, or too small or too coarse for the frequency.
    """
    rows, columns = pattern.shape
    mean = float(pattern.double().mean())
    if not mean > 0:
        raise DataError("the PSF is dark: it has no contrast to measure")
    spectrum = rfft2((pattern - mean).contiguous())
    along = torch.fft.fftfreq(rows, pixel_um * 1e-3, dtype=torch.float64)
    across = torch.fft.rfftfreq(columns, pixel_um * 1e-3, dtype=torch.float64)
    radius = torch.hypot(along[:, None].expand(-1, len(across)), across.expand(len(along), -1))
    half_width = _RING_STEPS * 1e3 / (pixel_um * min(rows, columns))
    ring = ((radius - per_mm).abs() < half_width) & (radius > 0)
    if per_mm > 5e2 / pixel_um or not ring.any():
        raise DataError(
            f"{per_mm:g} lines per mm cannot be measured on {rows}×{columns} pixels of "
            f"{pixel_um:g} um: choose up to {5e2 / pixel_um:.0f}, or a larger PSF"
        )
    power = float(spectrum.abs().double().square()[ring].mean())
    area_mm2 = rows * columns * (pixel_um * 1e-3) ** 2
    return math.sqrt(area_mm2 * power) / (rows * columns * mean)


def sparsity(pattern: Tensor, noise: float = 0.0) -> float:
    r"""Fraction of the area without light, :math:`1 - (Σp)^2 / (N Σp^2)`: 0 for an even PSF.

    Parameters
    ----------
    pattern
        Of any shape, in any unit.
    noise
        Standard deviation of the noise in it, whose square is taken off the mean of p².

    Raises
    ------
    DataError
        If it is dark.
    """
    values = pattern.double()
    squared = float(values.square().mean()) - noise**2
    if not squared > 0:
        raise DataError("the PSF is dark: it has no light to measure")
    return 1 - float(values.mean()) ** 2 / squared
