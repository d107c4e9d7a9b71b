"""Frames of a point source become a PSF."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.calibrate.point_band import Band, usable_band
from nolens.calibrate.point_frames import FrameMean, black_plane
from nolens.calibrate.point_merge import Exposure, Merged, merge
from nolens.calibrate.point_noise import Noise, noise_of_samples, noise_of_sensor, noise_squares
from nolens.calibrate.point_stray import DarkArea, dark_area, floor, stray_light
from nolens.camera import Frame, Sensor
from nolens.camera.measurement import colour_planes
from nolens.errors import DataError

StrayLight = Literal["auto", "none", "floor"]
"""Fitted where an aperture leaves a dark area, left in, or taken to be the darkest light."""

_MOST_SATURATED = 1e-3
_AROUND = 15
_LEAST_CONTRAST = 0.1
"""Of fine structure; a scene of some degrees shows less than 1 % through an open mask."""
_SMALLEST = 16
"""Pixels along the shorter side of a frame."""
_LINEAR = 0.95
"""Share of white below which the noise is looked at."""


_AS_IS = "or take a PSF that is finished as it is (--as-is)"


@dataclass(frozen=True)
class PointPsf:
    """A PSF as the sensor captured it, in its own place.

    Parameters
    ----------
    psf
        (channels, rows, columns), counts in a second (of one frame, if no time is known) on the
        cells of the reconstruction; not negative.
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
        Where an aperture leaves no light; None if the pattern fills the sensor.
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
) -> PointPsf:
    """Make a PSF of the frames of one point source.

    Parameters
    ----------
    exposures
        Frames by exposure time in s.
    darks
        For each of these times its dark frames; none takes the black level of the frames.
    cell_um
        Distance of the cells: of the pixels, or of the 2×2 cells of a mosaic.
    sensor
        Its noise serves where there is one frame only.
    stray
        What counts as stray light.
    as_is
        The frames are a finished PSF, such as other people's: only their black level is
        subtracted, and saturated pixels or a faint structure are no errors.

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
    ready = {time: _exposure(mean, time, darks.get(time)) for time, mean in exposures.items()}
    noise = _noise(exposures, ready, sensor)
    merged = merge(list(ready.values()), noise)
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
    halves = _half_difference(exposures, darks, noise)
    planes = [None] * len(picture) if halves is None else list(on_cells(halves, first))
    bands = tuple(
        usable_band(plane, cell_um, variance=own, noise=half)
        for plane, own, half in zip(picture, variance, planes, strict=True)
    )
    psf = (picture - removed).clamp_min(0)
    if not float(psf.max()) > 0:
        raise DataError(f"{first.source} shows no light of a point beside the stray light")
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


def on_cells(values: Tensor, frame: Frame) -> Tensor:
    """Values of a frame's pixels on the cells of the reconstruction, as `develop` merges them."""
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
        for plane, kept in zip(_planes(each.signal, mean.first), _planes(used, mean.first),
                               strict=True):  # fmt: skip
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
