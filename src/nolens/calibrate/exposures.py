"""Exposures of one light: their noise, and a linear picture merged of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.calibrate.frames import FrameMean, black_plane
from nolens.camera import Frame, Sensor
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError

_BINS = 48
_LEAST_IN_BIN = 64
_ROUNDING = 1 / 12
"""Variance of a count that is rounded to a whole one."""
_LAPLACES = ((1.0, -2.0, 1.0), (-2.0, 4.0, -2.0), (1.0, -2.0, 1.0))
_LAPLACES_POWER = 36.0
_LINEAR = 0.95
"""Fraction of white below which the noise is estimated."""
_ROUNDS = 3
_CLEAR_OF_WHITE = 3.0
"""Standard deviations that the mean of a usable pixel lies below white."""
_BRIGHT = 0.2
"""Fraction of white from which pixels tell how two exposure times compare."""
_LEAST_BRIGHT = 50
_MOST_OFF = 0.1
"""Difference of stated and measured ratio of exposures that is not the shutter's."""


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

    @classmethod
    def of_sensor(cls, sensor: Sensor) -> "Noise":
        """Noise as the description of the sensor has it."""
        slope = sensor.counts_per_electron * sensor.gain
        read = (sensor.read_noise_electrons * slope) ** 2
        return cls(read + _ROUNDING, slope, "camera")


def noise_of_samples(signals: list[Tensor], squares: list[Tensor], fallback: Noise) -> Noise:
    r"""Fit the photon transfer curve :math:`v(s) = σ^2 + g\,s` (`janesick2007`).

    Pixels are gathered by their signal into bins of equal number; a line is laid through the
    bins' means, each weighted by its own spread, :math:`v/\sqrt{N/2}`, in a few rounds.

    Parameters
    ----------
    signals
        Counts above black, of pixels that are not saturated; any shape.
    squares
        For each, a square whose mean is the variance of one frame.
    fallback
        Says where the squares come from; its figures serve where there are too few pixels for
        bins.
    """
    signal = torch.cat([each.flatten() for each in signals]).double()
    square = torch.cat([each.flatten() for each in squares]).double()
    bins = min(_BINS, len(signal) // _LEAST_IN_BIN)
    if bins < 2:
        return fallback
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
    return Noise(read, slope, fallback.known_from)


def noise_squares(plane: Tensor) -> Tensor:
    r"""Squares with the mean σ², from the fine structure of one picture (`immerkaer1996`).

    The difference of two Laplace operators, :math:`[1, -2, 1]^T [1, -2, 1]`, lets nothing smooth
    pass, and multiplies the variance of noise by 36. A plane of one colour, (rows, columns), has
    (rows − 2, columns − 2) of them.
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

    @classmethod
    def of(
        cls, mean: FrameMean, exposure_s: float, dark: FrameMean | None, half: int | None = None
    ) -> "Exposure":
        """Frames less their dark frames, or less the black level; all of them, or one half.

        Raises
        ------
        DataError
            If the dark frames are brighter than the frames.
        """
        values, frames = (mean.mean, mean.count) if half is None else mean.half(half)
        black = black_plane(mean.first)
        if dark is None:
            return cls(values - black, mean.clipped, frames, exposure_s, mean.white - black)
        below, count = dark.mean, dark.count
        if half is not None and dark.count > 1:
            below, count = dark.half(half)
        if float(below.double().mean()) > float(values.double().mean()):
            raise DataError(
                f"the dark frame {dark.first.source} is brighter than {mean.first.source}: "
                "exchange them, or take dark frames with the light off"
            )
        clipped = mean.clipped | dark.clipped
        return cls(values - below, clipped, frames, exposure_s, mean.white - below, count)

    def variance(self, noise: Noise, signal: Tensor) -> Tensor:
        """Variance of the mean, for a signal."""
        dark = 0.0 if self.dark_frames is None else noise.read_variance / self.dark_frames
        return noise.variance(signal) / self.frames + dark

    @property
    def linear(self) -> Tensor:
        """Pixels far enough below white for an estimate of the noise."""
        return ~self.clipped & (self.signal < _LINEAR * self.white)

    def usable(self, noise: Noise) -> Tensor:
        """Pixels whose mean is not cut off: excluding only those that clip would bias it."""
        return ~self.clipped & (
            self.signal + _CLEAR_OF_WHITE * noise.variance(self.signal).sqrt() < self.white
        )


@dataclass(frozen=True)
class _Merged:
    """A linear picture, counts above black in a second, with its variance.

    Where every exposure clips (`saturated`), the rate is that of the shortest one, too low.
    `ratios` say of each exposure, shortest first, how much brighter it is than its time says.
    """

    rate: Tensor
    variance: Tensor
    saturated: Tensor
    ratios: tuple[float, ...]


def merge(exposures: list[Exposure], noise: Noise) -> _Merged:
    r"""Merge exposures, each pixel weighted by how little noise it has.

    For counts :math:`s_j` of time :math:`t_j` the rate is :math:`x = Σ w_j s_j/t_j \,/\, Σ w_j`,
    :math:`w_j = t_j^2 / v_j`, :math:`v_j = (σ^2 + g\,x\,t_j)/n_j` and the noise of the dark
    frames: the estimate of least variance for shot and read noise (`hasinoff2010`). The variance
    is taken for the rate of the round before, not for the noisy count itself, which would favour
    counts that are too low. Saturated pixels have no weight (`debevec1997`). What the shutter
    does to the times shows on pixels that are bright in two exposures and clip in neither
    (`ratios`), and the times are corrected by it.

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
    return _Merged(rate, torch.stack(weights).sum(dim=0).reciprocal(), saturated, ratios)


def _weighted(ordered: list[Exposure], times: list[float], weights: list[Tensor]) -> Tensor:
    """Weighted mean of the exposures' counts in a second."""
    total = torch.stack(weights).sum(dim=0)
    parts = [
        weight * each.signal / time
        for each, time, weight in zip(ordered, times, weights, strict=True)
    ]
    return torch.stack(parts).sum(dim=0) / total


def _ratios(ordered: list[Exposure], usable: list[Tensor]) -> tuple[float, ...]:
    """How much brighter each is than its time says, beside the shortest one."""
    ratios = [1.0]
    for (short, long), (one, other) in zip(pairwise(ordered), pairwise(usable), strict=True):
        both = one & other & (long.signal > _BRIGHT * long.white)
        if int(both.sum()) < _LEAST_BRIGHT:
            ratios.append(ratios[-1])
            continue
        brighter = float(long.signal[both].double().sum() / short.signal[both].double().sum())
        stated = long.exposure_s / short.exposure_s
        if not abs(brighter / stated - 1) <= _MOST_OFF:
            raise DataError(
                f"frames of {1e3 * long.exposure_s:g} ms are {brighter:.3g} times as bright as "
                f"those of {1e3 * short.exposure_s:g} ms, not {stated:.3g} times: keep the light "
                "and all other settings the same, or correct the times (--exposure)"
            )
        ratios.append(ratios[-1] * brighter / stated)
    return tuple(ratios)


def superpixels(values: Tensor, frame: Frame) -> Tensor:
    """Values of a frame on the pixels of the reconstruction, as `develop` merges a mosaic."""
    if frame.mosaic is None:
        return values
    return torch.stack([torch.stack(planes).mean(dim=0) for planes in _colours(values, frame)])


def superpixel_variance(variance: Tensor, frame: Frame) -> Tensor:
    """Variance of `superpixels`: of a mean of two, half of theirs."""
    merged = superpixels(variance, frame)
    return merged if frame.mosaic is None else merged / torch.tensor([1.0, 2, 1])[:, None, None]


def _colours(values: Tensor, frame: Frame) -> list[list[Tensor]]:
    """Planes of each colour: one, of a mosaic's green two."""
    if frame.mosaic is None:
        return [[plane] for plane in values]
    rows, columns = (n // 2 * 2 for n in values.shape[-2:])
    return list(colour_planes(values[0, :rows, :columns], frame.mosaic).values())


def _planes(values: Tensor, frame: Frame) -> list[Tensor]:
    """Planes of one colour each."""
    return [plane for planes in _colours(values, frame) for plane in planes]


def noise_of_frames(
    means: Mapping[float, FrameMean], exposures: Mapping[float, Exposure], sensor: Sensor | None
) -> Noise:
    """Noise from the difference of frames of one exposure time.

    Where each exposure has one frame only, from the description of the sensor, or else from the
    fine structure. The exposures are the means less their dark frames.
    """
    signals, squares = [], []
    for time, mean in means.items():
        difference = mean.half_difference()
        if difference is not None:
            used = exposures[time].linear
            signals.append(exposures[time].signal[used])
            squares.append(difference[used].square())
    if signals and sum(map(len, signals)) > 0:
        level = float(torch.cat(squares).double().mean())
        return noise_of_samples(signals, squares, Noise(level, 0.0, "frames"))
    if sensor is not None:
        return Noise.of_sensor(sensor)
    for time, mean in means.items():
        each = exposures[time]
        for plane, used in zip(
            _planes(each.signal, mean.first), _planes(each.linear, mean.first), strict=True
        ):
            inner = used[1:-1, 1:-1]
            around = nnf.avg_pool2d(plane[None, None], 3, 1)[0, 0]
            signals.append(around[inner])
            squares.append(noise_squares(plane)[inner] * each.frames)
    # The finest structure of the PSF itself is among the brightest squares.
    level = float(torch.cat(squares).median()) / 0.455
    return noise_of_samples(signals, squares, Noise(level, 0.0, "picture"))


def merged_half_difference(
    exposures: Mapping[float, FrameMean], darks: Mapping[float, FrameMean], noise: Noise
) -> Tensor | None:
    """Half the frames less the other half, as noisy as `merge` of all; None if any is single."""
    if any(mean.counts[1] == 0 for mean in exposures.values()):
        return None
    halves = [
        merge(
            [Exposure.of(mean, time, darks.get(time), half) for time, mean in exposures.items()],
            noise,
        )
        for half in (0, 1)
    ]
    counts = [sum(mean.counts[half] for mean in exposures.values()) for half in (0, 1)]
    factor = math.sqrt(counts[0] * counts[1]) / sum(counts)
    difference: Tensor = (halves[0].rate - halves[1].rate) * factor
    return difference
