"""Frames of a point source become a PSF."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.calibrate.distances import with_mean_light
from nolens.calibrate.magnify import covered, magnified
from nolens.calibrate.point_band import Band, usable_band
from nolens.calibrate.point_frames import FrameMean, black_plane
from nolens.calibrate.point_stray import DarkArea, dark_area, floor, stray_light
from nolens.camera import Frame, Sensor
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError

_BINS = 48
_LEAST_IN_BIN = 64
_ROUNDING = 1 / 12
"""Variance of a count that is rounded to a whole one."""
_LAPLACES = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
_LAPLACES_POWER = 36.0
_ROUNDS = 3
_CLEAR_OF_WHITE = 3.0
"""Standard deviations that the mean of a usable pixel lies below white."""
_BRIGHT = 0.2
"""Fraction of white from which pixels tell how two exposure times compare."""
_LEAST_BRIGHT = 50
_MOST_OFF = 0.1
"""Difference of stated and seen ratio of exposures that is not the shutter's."""
UNCERTAIN_RATIO = 0.02
"""The same, that a person should hear of."""
StrayLight = Literal["auto", "none", "floor"]
"""Fitted where an aperture leaves a dark area, left in, or taken to be the darkest light."""
_MOST_SATURATED = 1e-3
_AROUND = 15
_LEAST_CONTRAST = 0.1
"""Of fine structure; a scene of some degrees shows less than 1 % through an open mask."""
_SMALLEST = 16
"""Pixels along the shorter side of a frame."""
_LINEAR = 0.95
"""Fraction of white below which the noise is looked at."""
_BYTES_PER_PIXEL, _BYTES_PER_EXPOSURE = 100, 40
_AS_IS = "or take a PSF that is finished as it is (--as-is)"


@dataclass(frozen=True)
class Noise:
    r"""Noise of one frame: the variance of a pixel is :math:`σ^2 + g\,s` for a signal s in counts.

    Parameters
    ----------
    read_variance
        σ² without light, in counts².
    counts_per_electron
        g, the slope of shot noise.
    known_from
        Two or more frames, the camera's description, or the fine structure of one picture.
    """

    read_variance: float
    counts_per_electron: float
    known_from: Literal["frames", "camera", "picture"]

    def variance(self, signal: Tensor) -> Tensor:
        """Variance of a pixel of one frame, in counts²."""
        return self.read_variance + self.counts_per_electron * signal.clamp_min(0)


def noise_of_sensor(sensor: Sensor) -> Noise:
    """Noise as the description of the sensor has it."""
    slope = sensor.counts_per_electron * sensor.gain
    read = (sensor.read_noise_electrons * slope) ** 2
    return Noise(read + _ROUNDING, slope, "camera")


def noise_of_samples(signals: list[Tensor], squares: list[Tensor], source: Noise) -> Noise:
    r"""Fit the photon transfer curve :math:`v(s) = σ^2 + g\,s` (`janesick2007`).

    Pixels are gathered by their signal into bins of equal number; a line is laid through the
    bins' means, each weighted by its own spread, :math:`v/\sqrt{N/2}`, in a few rounds.

    Parameters
    ----------
    signals
        Counts above black, of pixels that are not saturated; any shape.
    squares
        For each, a square whose mean is the variance of one frame.
    source
        Where the squares come from; its figures serve where there are too few pixels for bins.
    """
    signal = torch.cat([each.flatten() for each in signals]).double()
    square = torch.cat([each.flatten() for each in squares]).double()
    bins = min(_BINS, len(signal) // _LEAST_IN_BIN)
    if bins < 2:
        return source
    order = signal.argsort()
    groups = [torch.tensor_split(each[order], bins) for each in (signal, square)]
    mean, variance = (torch.stack([part.mean() for part in group]) for group in groups)
    fitted = variance.clamp_min(_ROUNDING)
    read, slope = float(fitted.min()), 0.0
    for _ in range(5):
        weight = fitted.square().reciprocal()
        centre = (weight * mean).sum() / weight.sum()
        level = (weight * variance).sum() / weight.sum()
        spread = (weight * (mean - centre).square()).sum()
        if float(spread) > 0:
            slope = float((weight * (mean - centre) * (variance - level)).sum() / spread)
        slope = max(slope, 0.0)
        read = max(float(level - slope * centre), _ROUNDING)
        fitted = read + slope * mean.clamp_min(0)
    return Noise(read, slope, source.known_from)


def noise_squares(plane: Tensor) -> Tensor:
    r"""Squares with the mean σ², from the fine structure of one picture (`immerkaer1996`).

    The difference of two Laplace operators, :math:`[1, -2, 1]^T [1, -2, 1]`, lets nothing smooth
    pass, and multiplies the variance of noise by 36.

    Parameters
    ----------
    plane
        (rows, columns) of one colour.

    Returns
    -------
    Tensor
        (rows − 2, columns − 2).
    """
    kernel = torch.tensor(_LAPLACES, dtype=plane.dtype)[None, None]
    return nnf.conv2d(plane[None, None], kernel)[0, 0].square() / _LAPLACES_POWER


@dataclass(frozen=True)
class Exposure:
    """The mean of some frames of one exposure time.

    Parameters
    ----------
    signal
        Counts above black or dark, float32.
    clipped
        Where any of them is saturated.
    frames
        How many there are.
    exposure_s
        Exposure time.
    white
        Count above black from which a pixel is saturated; (rows and columns may be 1).
    dark_frames
        Dark frames whose mean was subtracted; None where a known black level was.
    """

    signal: Tensor
    clipped: Tensor
    frames: int
    exposure_s: float
    white: Tensor
    dark_frames: int | None = None

    def variance(self, noise: Noise, signal: Tensor) -> Tensor:
        """Variance of the mean, for a signal."""
        dark = 0.0 if self.dark_frames is None else noise.read_variance / self.dark_frames
        return noise.variance(signal) / self.frames + dark

    def usable(self, noise: Noise) -> Tensor:
        """Pixels whose mean is not cut off: excluding only those that clip would bias it."""
        return ~self.clipped & (
            self.signal + _CLEAR_OF_WHITE * noise.variance(self.signal).sqrt() < self.white
        )


@dataclass(frozen=True)
class Merged:
    """A linear picture.

    Parameters
    ----------
    rate
        Counts above black in a second, of the shape of the frames.
    variance
        Its variance.
    saturated
        Where every exposure clips: there the rate is that of the shortest one, too low.
    ratios
        For each exposure, shortest first, how much brighter it is than its time says.
    """

    rate: Tensor
    variance: Tensor
    saturated: Tensor
    ratios: tuple[float, ...]


def merge(exposures: list[Exposure], noise: Noise) -> Merged:
    r"""Merge exposures, each pixel weighted by how little noise it has.

    For counts :math:`s_j` of time :math:`t_j` the rate is :math:`x = Σ w_j s_j/t_j \,/\, Σ w_j`,
    :math:`w_j = t_j^2 / v_j`, :math:`v_j = (σ^2 + g\,x\,t_j)/n_j` and the noise of the dark
    frames: the estimate of least variance for shot and read noise (`hasinoff2010`). The variance
    is taken for the rate of the round before, not for the noisy count itself, which would favour
    counts that are too low. Saturated pixels have no weight (`debevec1997`). What the shutter
    does to the times is seen on pixels that are bright in two exposures and clip in neither
    (`ratios`), and the times are corrected by it.

    Parameters
    ----------
    exposures
        One for each exposure time.
    noise
        Of one frame.

    Raises
    ------
    DataError
        If the brightness of two exposures is not at all as their times say.
    """
    ordered = sorted(exposures, key=lambda each: each.exposure_s)
    usable = [each.usable(noise) for each in ordered]
    ratios = _ratios(ordered, usable)
    times = [each.exposure_s * ratio for each, ratio in zip(ordered, ratios, strict=True)]
    saturated = ~torch.stack(usable).any(dim=0)
    usable[0] = usable[0] | saturated
    rate = _weighted(
        ordered,
        times,
        [
            mask * (each.frames * time * time)
            for each, time, mask in zip(ordered, times, usable, strict=True)
        ],
    )
    for _ in range(_ROUNDS):
        weights = [
            mask * time * time / each.variance(noise, rate * time)
            for each, time, mask in zip(ordered, times, usable, strict=True)
        ]
        rate = _weighted(ordered, times, weights)
    return Merged(rate, torch.stack(weights).sum(dim=0).reciprocal(), saturated, ratios)


def _weighted(ordered: list[Exposure], times: list[float], weights: list[Tensor]) -> Tensor:
    total = torch.stack(weights).sum(dim=0)
    parts = [
        weight * each.signal / time
        for each, time, weight in zip(ordered, times, weights, strict=True)
    ]
    return torch.stack(parts).sum(dim=0) / total


def _ratios(ordered: list[Exposure], usable: list[Tensor]) -> tuple[float, ...]:
    """How much brighter each is than its time says, beside the shortest one."""
    found = [1.0]
    for (short, long), (one, other) in zip(pairwise(ordered), pairwise(usable), strict=True):
        both = one & other & (long.signal > _BRIGHT * long.white)
        if int(both.sum()) < _LEAST_BRIGHT:
            found.append(found[-1])
            continue
        brighter = float(long.signal[both].double().sum() / short.signal[both].double().sum())
        stated = long.exposure_s / short.exposure_s
        if not abs(brighter / stated - 1) <= _MOST_OFF:
            raise DataError(
                f"frames of {1e3 * long.exposure_s:g} ms are {brighter:.3g} times as bright as "
                f"those of {1e3 * short.exposure_s:g} ms, not {stated:.3g} times: keep the light "
                "and all other settings the same, or correct the times (--exposure)"
            )
        found.append(found[-1] * brighter / stated)
    return tuple(found)


def moved_to_middle(psf: Tensor, shift: tuple[float, float]) -> Tensor:
    """A PSF whose light lies `shift` (row, column) beside the middle, moved back into it.

    What moves in from beyond its edges has the mean light around it.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    shift
        In pixels, as `centroid` gives it.
    """
    back = (-shift[0], -shift[1])
    known = covered((psf.shape[-2], psf.shape[-1]), 1.0, moved=back)
    return with_mean_light(magnified(psf, 1.0, moved=back), known)


def centroid(psf: Tensor, dark: Tensor) -> tuple[float, float]:
    """Centre of the light outside the dark area, (row, column) in pixels from the middle.

    Parameters
    ----------
    psf
        (channels, rows, columns), without stray light.
    dark
        Bool, (rows, columns): pixels that have no light of the point.
    """
    light = psf.double().clamp_min(0).sum(dim=0) * ~dark
    light = light / light.sum()
    places = [torch.arange(n, dtype=torch.float64) - (n - 1) / 2 for n in light.shape]
    return float(light.sum(dim=1) @ places[0]), float(light.sum(dim=0) @ places[1])


@dataclass(frozen=True)
class PointPsf:
    """A PSF as the sensor captured it, in its own place.

    Parameters
    ----------
    psf
        (channels, rows, columns), counts in a second (of one frame, if no time is known) on the
        pixels of the reconstruction; not negative.
    noise_rms
        Of each channel, in the same unit.
    noise
        Of one frame.
    saturated_share
        Of the pixels, in every exposure.
    ratios
        How much brighter each exposure is than its time says, shortest first.
    stray
        Mean stray light of each channel that was taken away.
    floor
        Light of the darkest hundredth of each channel, which was left in.
    area
        Where an aperture leaves no light; None if the PSF fills the sensor.
    bands
        Spectrum of each channel beside its noise's.
    contrast
        Of the fine structure: its standard deviation over the mean.
    """

    psf: Tensor
    noise_rms: tuple[float, ...]
    noise: Noise
    saturated_share: float
    ratios: tuple[float, ...]
    stray: tuple[float, ...]
    floor: tuple[float, ...]
    area: DarkArea | None
    bands: tuple[Band, ...]
    contrast: float


def point_psf(
    exposures: Mapping[float, FrameMean],
    darks: Mapping[float, FrameMean],
    *,
    cell_um: float,
    sensor: Sensor | None = None,
    stray: StrayLight = "auto",
    as_is: bool = False,
    tick: Callable[[float], None] | None = None,
) -> PointPsf:
    """Make a PSF of the frames of one point source.

    Parameters
    ----------
    exposures
        Frames by exposure time in s.
    darks
        For each of these times its dark frames; none takes the black level of the frames.
    cell_um
        Pitch of the pixels: the sensor's own, or the 2×2 superpixels of a mosaic.
    sensor
        Its noise serves where there is one frame only.
    stray
        What counts as stray light.
    as_is
        The frames are a finished PSF, such as other people's: only their black level is
        subtracted, and saturated pixels or a faint structure are no errors.
    tick
        Called with the share that is done, 0 to 1.

    Raises
    ------
    DataError
        If no exposure is free of saturated pixels, dark frames are brighter than the frames,
        they show no point source, or are smaller than 16×16 pixels.
    """
    first = next(iter(exposures.values())).first
    if min(first.size) < _SMALLEST:
        raise DataError(
            f"{first.source} is {first.size_text} pixels, too small for a PSF: give frames of at "
            f"least {_SMALLEST}×{_SMALLEST}"
        )
    told = tick or (lambda share: None)
    told(0.0)
    ready = {time: _exposure(mean, time, darks.get(time)) for time, mean in exposures.items()}
    noise = _noise(exposures, ready, sensor)
    told(0.2)
    merged = merge(list(ready.values()), noise)
    told(0.4)
    share = float(merged.saturated.double().mean())
    if share > _MOST_SATURATED and not as_is:
        raise DataError(
            f"{100 * share:.2g} % of the pixels are saturated in every exposure of "
            f"{first.source}, and what they would have shown is lost: add frames of a shorter "
            f"exposure time, {_AS_IS}"
        )
    picture, variance = on_cells(merged.rate, first), _variance(merged.variance, first)
    contrast = _contrast(picture, variance, None if as_is else first.source)
    area = dark_area(picture)
    removed = torch.zeros_like(picture)
    if as_is:
        pass
    elif stray == "floor":
        removed = removed + floor(picture)
    elif stray == "auto" and area is not None:
        removed = stray_light(picture, area)
    told(0.6)
    halves = _half_difference(exposures, darks, noise)
    told(0.8)
    planes = [None] * len(picture) if halves is None else list(on_cells(halves, first))
    bands = tuple(
        usable_band(plane, cell_um, variance=own, noise=half)
        for plane, own, half in zip(picture, variance, planes, strict=True)
    )
    psf = (picture - removed).clamp_min(0)
    if not float(psf.max()) > 0:
        raise DataError(f"{first.source} shows no light of a point source besides the stray light")
    return PointPsf(
        psf,
        tuple(float(plane.double().mean().sqrt()) for plane in variance),
        noise,
        share,
        merged.ratios,
        tuple(removed.double().mean(dim=(-2, -1)).tolist()),
        tuple(floor(picture - removed).flatten().tolist()),
        area,
        bands,
        contrast,
    )


def point_psf_bytes(pixels: int, exposures: int) -> float:
    """Most memory that `point_psf` holds at once, frames included.

    Parameters
    ----------
    pixels
        Of a frame.
    exposures
        Exposure times.
    """
    return pixels * (_BYTES_PER_PIXEL + _BYTES_PER_EXPOSURE * exposures)


def on_cells(values: Tensor, frame: Frame) -> Tensor:
    """Values of a frame on the pixels of the reconstruction, as `develop` merges them."""
    if frame.mosaic is None:
        return values
    rows, columns = (n // 2 * 2 for n in values.shape[-2:])
    planes = colour_planes(values[0, :rows, :columns], frame.mosaic)
    return torch.stack([torch.stack(cells).mean(dim=0) for cells in planes.values()])


def _variance(variance: Tensor, frame: Frame) -> Tensor:
    """Variance of `on_cells`: of a mean of two, half of theirs."""
    merged = on_cells(variance, frame)
    return merged if frame.mosaic is None else merged / torch.tensor([1.0, 2, 1])[:, None, None]


def _exposure(
    mean: FrameMean, time: float, dark: FrameMean | None, half: int | None = None
) -> Exposure:
    values, frames = (mean.mean, mean.count) if half is None else mean.half(half)
    black = black_plane(mean.first)
    if dark is None:
        return Exposure(values - black, mean.clipped, frames, time, mean.white - black)
    below, count = dark.mean, dark.count
    if half is not None and dark.count > 1:
        below, count = dark.half(half)
    if float(below.double().mean()) > float(values.double().mean()):
        raise DataError(
            f"the dark frame {dark.first.source} is brighter than {mean.first.source}: exchange "
            "them, or take dark frames with the light off"
        )
    clipped = mean.clipped | dark.clipped
    return Exposure(values - below, clipped, frames, time, mean.white - below, count)


def _noise(
    means: Mapping[float, FrameMean], ready: Mapping[float, Exposure], sensor: Sensor | None
) -> Noise:
    """From the difference of frames; else from the sensor's description, or fine structure."""
    signals, squares = [], []
    for time, mean in means.items():
        halves = mean.half_difference()
        if halves is not None:
            used = _linear(ready[time])
            signals.append(ready[time].signal[used])
            squares.append(halves[used].square())
    if signals and sum(map(len, signals)) > 0:
        level = float(torch.cat(squares).double().mean())
        return noise_of_samples(signals, squares, Noise(level, 0.0, "frames"))
    if sensor is not None:
        return noise_of_sensor(sensor)
    for time, mean in means.items():
        each, used = ready[time], _linear(ready[time])
        for plane, kept in zip(
            _planes(each.signal, mean.first), _planes(used, mean.first), strict=True
        ):
            inner = kept[1:-1, 1:-1]
            around = nnf.avg_pool2d(plane[None, None], 3, 1)[0, 0]
            signals.append(around[inner])
            squares.append(noise_squares(plane)[inner] * each.frames)
    # The finest structure of the pattern itself is among the brightest squares.
    level = float(torch.cat(squares).median()) / 0.455
    return noise_of_samples(signals, squares, Noise(level, 0.0, "picture"))


def _linear(exposure: Exposure) -> Tensor:
    return ~exposure.clipped & (exposure.signal < _LINEAR * exposure.white)


def _planes(values: Tensor, frame: Frame) -> list[Tensor]:
    """Planes of one colour each."""
    if frame.mosaic is None:
        return list(values)
    rows, columns = (n // 2 * 2 for n in values.shape[-2:])
    colours = colour_planes(values[0, :rows, :columns], frame.mosaic)
    return [plane for planes in colours.values() for plane in planes]


def _half_difference(
    exposures: Mapping[float, FrameMean], darks: Mapping[float, FrameMean], noise: Noise
) -> Tensor | None:
    """Half the frames less the other half, as noisy as the mean of all; None if any is single."""
    if any(mean.counts[1] == 0 for mean in exposures.values()):
        return None
    halves: list[Merged] = []
    for half in (0, 1):
        parts = [_exposure(mean, time, darks.get(time), half) for time, mean in exposures.items()]
        halves.append(merge(parts, noise))
    counts = [sum(mean.counts[half] for mean in exposures.values()) for half in (0, 1)]
    factor = math.sqrt(counts[0] * counts[1]) / sum(counts)
    difference: Tensor = (halves[0].rate - halves[1].rate) * factor
    return difference


def _contrast(picture: Tensor, variance: Tensor, source: str | None) -> float:
    """Contrast of the fine structure, which only a point source gives.

    Any other light is refused, where the name of its file is given for the message.
    """
    weight = picture.mean(dim=(-2, -1), keepdim=True).clamp_min(0)
    total = weight.sum()
    grey = (picture * weight).sum(dim=0) / total if total > 0 else picture.mean(dim=0)
    noise = (variance * weight.square()).sum(dim=0) / total**2 if total > 0 else variance.mean(0)
    side = min(_AROUND, min(grey.shape) // 2 * 2 - 1)
    around = nnf.avg_pool2d(nnf.pad(grey[None, None], (side // 2,) * 4, mode="reflect"), side, 1)[
        0, 0
    ]
    spread = float((grey - around).double().square().mean())
    floor_of_noise = float(noise.double().mean())
    mean = float(grey.double().mean())
    if source is not None and not (mean > 0 and spread > 2 * floor_of_noise):
        raise DataError(
            f"{source} shows nothing above its noise: a picture of a point source is needed. "
            f"Check the file and its black level, expose longer, take more frames, {_AS_IS}"
        )
    contrast = math.sqrt(max(0.0, spread - floor_of_noise)) / mean if mean > 0 else 0.0
    if source is not None and contrast < _LEAST_CONTRAST:
        raise DataError(
            f"{source} shows no point source: its fine structure has a contrast of "
            f"{100 * contrast:.2g} %, as that of a scene or of even light has. Take a small "
            f"light, such as an LED behind a pinhole, in a dark room, {_AS_IS}"
        )
    return contrast
