"""Frames of several exposure times, merged to one linear picture."""

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from nolens.calibrate.point_noise import Noise
from nolens.errors import DataError

_ROUNDS = 3
_CLEAR_OF_WHITE = 3.0
"""Standard deviations that the mean of a usable pixel lies below white."""
_BRIGHT = 0.2
"""Share of white from which pixels tell how two exposure times compare."""
_LEAST_BRIGHT = 50
_MOST_OFF = 0.1
"""Difference of stated and seen ratio of exposures that is not the shutter's."""
UNCERTAIN_RATIO = 0.02
"""The same, that a person should hear of."""


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
        ordered, times, [mask * (each.frames * time * time) for each, time, mask in
                         zip(ordered, times, usable, strict=True)],
    )  # fmt: skip
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
