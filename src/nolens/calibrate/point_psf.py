"""The PSF of a point source's frames: without stray light, with its noise and usable band."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.calibrate.exposures import (
    Exposure,
    Noise,
    merge,
    merged_half_difference,
    noise_of_frames,
    superpixel_variance,
    superpixels,
)
from nolens.calibrate.frames import FrameMean
from nolens.camera import Sensor
from nolens.errors import DataError
from nolens.kernels import rfft2
from nolens.progress import ProgressCallback, within

StrayLight = Literal["auto", "none", "floor"]
"""Fitted where an aperture leaves a dark area, left in, or taken to be the darkest light."""
_MOST_SATURATED = 1e-3
_UNCERTAIN_RATIO = 0.02
"""Difference of stated and measured ratio of exposures that a person should hear of."""
_AROUND = 15
_LEAST_CONTRAST = 0.1
"""Of fine structure; a scene of some degrees shows less than 1 % through an open mask."""
_SMALLEST = 16
"""Pixels along the shorter side of a frame."""
_BYTES_PER_PIXEL, _BYTES_PER_EXPOSURE = 100, 40
_FINISHED = "or import a finished PSF (nolens calibrate import)"

_BLOCKS = 64
"""Blocks along the shorter side, of which the dark area is made."""
_NEAR_FRACTION, _NEAR_PIXELS = 0.1, 48
"""How far a dark place lies from the PSF: farther than its lines from each other."""
_BRIGHTEST, _DARK_STEP, _DARK_FRACTION = 0.95, 0.03, 0.25
"""Of the light near the PSF's bright lines, what a dark area has more than the darkest place,
and what it has in all, at most."""
_LEAST_DARK, _MOST_DARK = 0.02, 0.97
_LEAST_BORDER = 0.5
_LEAST_FITTED = 24
_ROUNDS = 20
_CAUTION = 1.0
"""Standard deviations above the plane from which a block shows the PSF's own wings."""
_FLOOR = 0.01

_RINGS = 64
_LEAST_FREQUENCIES = 12


@dataclass(frozen=True)
class DarkArea:
    """Where an aperture keeps the PSF's light away: bool, by blocks of `side` by `side` pixels."""

    side: int
    dark: Tensor

    @property
    def fraction(self) -> float:
        """Fraction of the picture that is dark."""
        return float(self.dark.double().mean())

    def on_pixels(self, rows: int, columns: int) -> Tensor:
        """The dark blocks' pixels, (rows, columns); what is left over at the edges is not dark."""
        spread = self.dark.repeat_interleave(self.side, 0).repeat_interleave(self.side, 1)
        return nnf.pad(spread, (0, columns - spread.shape[1], 0, rows - spread.shape[0]))


def dark_area(psf: Tensor) -> DarkArea | None:
    """Find the part without light; None where the PSF fills the picture.

    Every place is judged by the brightest one near it, nearer than a tenth of the picture and 48
    pixels, so that the dark between a PSF's lines does not count. Dark are places that have
    hardly more than the darkest one, by 3 % of what there is near bright lines; they are a dark
    area if they have less than a quarter of the others' light, and half of the picture's edge.
    Stray light of up to that quarter does not matter, if it is even to 3 %.
    """
    shorter = min(psf.shape[-2:])
    side = max(2, shorter // _BLOCKS)
    blocks = nnf.avg_pool2d(psf.mean(dim=0)[None, None], side)[0, 0].double()
    extent = max(1, round(min(_NEAR_FRACTION * shorter, _NEAR_PIXELS) / side))
    near = nnf.max_pool2d(blocks[None, None], 2 * extent + 1, 1, extent)[0, 0]
    darkest = float(near.min())
    dark = near - darkest <= _DARK_STEP * (float(near.quantile(_BRIGHTEST)) - darkest)
    edge = torch.cat([dark[0], dark[-1], dark[1:-1, 0], dark[1:-1, -1]]).double().mean()
    fraction = float(dark.double().mean())
    if not (_LEAST_DARK <= fraction <= _MOST_DARK and float(edge) >= _LEAST_BORDER):
        return None
    if float(near[dark].mean()) > _DARK_FRACTION * float(near[~dark].mean()):
        return None
    return DarkArea(side, dark)


def stray_light(psf: Tensor, area: DarkArea) -> Tensor:
    r"""Smooth light of other sources, from where an aperture leaves no light of the point.

    In every channel a plane :math:`a + b r + c s` is laid through the
    means of the dark blocks. The PSF's own faint wings reach into
    them: blocks that lie above the plane count less the more they do (Huber's weights, `huber1964`,
    on that side alone), so that one through the darkest of them remains. A curved surface would
    follow the wings and take light of the PSF away. Where few blocks are dark, or on one side
    only, it is even.
    """
    rows, columns = psf.shape[-2:]
    used = area.dark
    blocks = nnf.avg_pool2d(psf[None], area.side)[0].double()
    order = 3 if _is_around(used) else 1
    places = [
        ((torch.arange(n, dtype=torch.float64) + 0.5) * area.side / size * 2 - 1)
        for n, size in zip(blocks.shape[-2:], (rows, columns), strict=True)
    ]
    basis = _surface(places[0], places[1], order)[used]
    fine = [torch.linspace(-1 + 1 / n, 1 - 1 / n, n, dtype=torch.float64) for n in (rows, columns)]
    everywhere = _surface(fine[0], fine[1], order)
    return torch.stack([everywhere @ _fit(basis, plane[used]) for plane in blocks]).to(psf.dtype)


def floor(psf: Tensor) -> Tensor:
    """Light of the darkest hundredth of blocks, (channels, 1, 1): the PSF's own, or stray."""
    side = max(2, min(psf.shape[-2:]) // _BLOCKS)
    blocks = nnf.avg_pool2d(psf[None], side)[0].flatten(1)
    return blocks.quantile(_FLOOR, dim=1)[:, None, None]


def _is_around(used: Tensor) -> bool:
    """Whether blocks lie on all sides, so that a plane is held everywhere."""
    if int(used.sum()) < _LEAST_FITTED:
        return False
    rows, columns = ((n + 3) // 4 for n in used.shape)
    sides = used[:rows], used[-rows:], used[:, :columns], used[:, -columns:]
    return all(bool(side.any()) for side in sides)


def _surface(rows: Tensor, columns: Tensor, order: int) -> Tensor:
    """Terms of the plane on a grid, (rows, columns, order)."""
    r, s = torch.meshgrid(rows, columns, indexing="ij")
    return torch.stack([torch.ones_like(r), r, s][:order], dim=-1)


def _fit(basis: Tensor, values: Tensor) -> Tensor:
    weight = torch.ones_like(values)
    for _ in range(_ROUNDS):
        scaled = basis * weight[:, None].sqrt()
        solution: Tensor = torch.linalg.lstsq(scaled, (values * weight.sqrt())[:, None]).solution[
            :, 0
        ]
        above = values - basis @ solution
        # Below the plane there is only noise; above it wings as well.
        below = above[above <= 0].abs()
        # Of an even plane rounding can leave all above.
        spread = 1.4826 * (below if len(below) else above).median().clamp_min(1e-30)
        weight = torch.where(
            above > 0, (_CAUTION * spread / above.clamp_min(1e-30)).clamp(max=1), 1.0
        )
    return solution


@dataclass(frozen=True)
class _Band:
    """Spectrum of a PSF beside that of its noise: the mean power in rings of spatial frequency.

    The signal's is what the picture has more than its noise. Up to `usable_per_mm` it is the larger
    one; zero if nowhere.
    """

    per_mm: tuple[float, ...]
    signal: tuple[float, ...]
    noise: tuple[float, ...]
    usable_per_mm: float


def usable_band(
    picture: Tensor, pixel_um: float, *, variance: Tensor, noise: Tensor | None = None
) -> _Band:
    r"""Compare the radial power spectra of a PSF and of its noise.

    Both are tapered by Hann's window, without which the edges of a PSF that fills the sensor
    would pass for fine structure. White noise of the variance v(x) has the power
    :math:`Σ v\,w^2` at every frequency.

    Parameters
    ----------
    picture
        (rows, columns), with noise.
    pixel_um
        Pitch of its pixels.
    variance
        Of the noise, of the same shape.
    noise
        A picture of noise alone, as strong as that in the picture; None takes the variance.

    Returns
    -------
    _Band
        In rings from the mean up to the finest frequency of the pixels.
    """
    rows, columns = picture.shape
    window = (
        torch.hann_window(rows, periodic=False)[:, None]
        * torch.hann_window(columns, periodic=False)
    ).to(picture.dtype)
    mean = (picture * window).sum() / window.sum()
    total = _power((picture - mean) * window)
    if noise is None:
        floor = torch.full_like(total, float((variance * window.square()).double().sum()))
    else:
        floor = _power(noise * window)
    along = torch.fft.fftfreq(rows, pixel_um * 1e-3, dtype=torch.float64)
    across = torch.fft.rfftfreq(columns, pixel_um * 1e-3, dtype=torch.float64)
    radius = torch.hypot(along[:, None].expand(-1, len(across)), across.expand(len(along), -1))
    finest = 5e2 / pixel_um
    rings = min(_RINGS, min(rows, columns) // 4)
    ring = (radius / finest * rings).long().flatten()
    inside = ring < rings
    number = torch.bincount(ring[inside], minlength=rings).double()
    means = [
        torch.bincount(ring[inside], each.flatten()[inside], minlength=rings) / number.clamp_min(1)
        for each in (total, floor)
    ]
    enough = number >= _LEAST_FREQUENCIES
    centres = (torch.arange(rings) + 0.5) / rings * finest
    signal = (means[0] - means[1]).clamp_min(0)
    drowned = ((signal < means[1]) & enough).nonzero()
    last = rings if len(drowned) == 0 else int(drowned[0])
    return _Band(
        tuple(centres.tolist()),
        tuple(signal.tolist()),
        tuple(means[1].tolist()),
        last / rings * finest,
    )


def _power(picture: Tensor) -> Tensor:
    return rfft2(picture.float().contiguous()).abs().double().square()


@dataclass(frozen=True)
class PointPsf:
    """A PSF as the sensor captured it, in its own place.

    Parameters
    ----------
    psf
        (channels, rows, columns), counts in a second (of one frame, if no time is known) on the
        pixels of the reconstruction. Noise makes dark pixels negative, too: without that the mean
        of the dark would be above zero, and a scene's glow with it.
    noise_rms
        Of each channel, in the same unit.
    noise
        Of one frame.
    saturated_fraction
        Of the pixels, in every exposure.
    ratios
        How much brighter each exposure is than its time says, shortest first.
    stray
        Mean stray light of each channel that was subtracted.
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
    saturated_fraction: float
    ratios: tuple[float, ...]
    stray: tuple[float, ...]
    floor: tuple[float, ...]
    area: DarkArea | None
    bands: tuple[_Band, ...]
    contrast: float

    @property
    def usable_per_mm(self) -> float:
        """Spatial frequency up to which all channels stand out of the noise; zero if nowhere."""
        return min(band.usable_per_mm for band in self.bands)

    def warnings(self, *, known_floor: bool) -> list[str]:
        """What may make the PSF worse than it could be.

        `known_floor` says whether the light of a PSF that fills the sensor is all its own.
        """
        texts = []
        if self.saturated_fraction > 0:
            texts.append(
                f"{100 * self.saturated_fraction:.2g} % of the pixels are saturated in every "
                "exposure, and too dark there: a frame of a shorter exposure gives them back"
            )
        if self.area is None and not known_floor:
            texts.append(
                "the PSF fills the sensor, so that nothing tells stray light from its own: what "
                "there is stays in. Dark frames (--dark), with the room as it was and the point "
                "source covered, take it away"
            )
        off = max(abs(ratio - 1) for ratio in self.ratios)
        if off > _UNCERTAIN_RATIO:
            texts.append(
                f"the exposures are up to {100 * off:.2g} % off what their times say, and were "
                "corrected: the light or the shutter is not steady"
            )
        if self.usable_per_mm <= 0:
            texts.append("the PSF's structure does not stand out of its noise: take more frames")
        return texts

    def figures(self) -> dict[str, Any]:
        """Figures of the PSF, in values that JSON has."""
        peak = float(self.psf.max())
        energy = self.psf.double().sum(dim=(-2, -1))
        peaks = self.psf.double().amax(dim=(-2, -1)).tolist()
        return {
            "peak": peak,
            "saturated_fraction": self.saturated_fraction,
            "frame_noise": {
                "read_counts": round(math.sqrt(self.noise.read_variance), 4),
                "counts_per_electron": round(self.noise.counts_per_electron, 5),
                "from": self.noise.known_from,
            },
            "noise_over_peak": [each / peak for each in self.noise_rms],
            "snr_db": [
                round(20 * math.log10(top / rms), 2) if top > 0 and rms > 0 else None
                for top, rms in zip(peaks, self.noise_rms, strict=True)
            ],
            "energy": (energy / energy.max()).tolist(),
            "contrast": round(self.contrast, 4),
            "dark_fraction": 0.0 if self.area is None else round(self.area.fraction, 4),
            "stray_over_peak": [each / peak for each in self.stray],
            "floor_over_peak": [each / peak for each in self.floor],
            "usable_per_mm_by_channel": [round(band.usable_per_mm, 2) for band in self.bands],
        }


def point_psf(
    exposures: Mapping[float, FrameMean],
    darks: Mapping[float, FrameMean],
    *,
    pixel_um: float,
    sensor: Sensor | None = None,
    stray: StrayLight = "auto",
    progress: ProgressCallback | None = None,
) -> PointPsf:
    """Make a PSF of the frames of one point source.

    Parameters
    ----------
    exposures
        Frames by exposure time in s.
    darks
        For each of these times its dark frames; none takes the black level of the frames.
    pixel_um
        Pitch of the pixels: the sensor's own, or the 2×2 superpixels of a mosaic.
    sensor
        Its noise serves where there is one frame only.
    stray
        What counts as stray light.
    progress
        Called with the fraction that is done, 0 to 1.

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
    advance = within(progress, 0.0, 1.0)
    advance(0.0)
    means = {time: Exposure.of(mean, time, darks.get(time)) for time, mean in exposures.items()}
    noise = noise_of_frames(exposures, means, sensor)
    advance(0.2)
    merged = merge(list(means.values()), noise)
    advance(0.4)
    saturated = float(merged.saturated.double().mean())
    if saturated > _MOST_SATURATED:
        raise DataError(
            f"{100 * saturated:.2g} % of the pixels are saturated in every exposure of "
            f"{first.source}, and what they would have held is lost: add frames of a shorter "
            f"exposure time, {_FINISHED}"
        )
    picture = superpixels(merged.rate, first)
    variance = superpixel_variance(merged.variance, first)
    contrast = _contrast(picture, variance, first.source)
    area = dark_area(picture)
    removed = torch.zeros_like(picture)
    if stray == "floor":
        removed = removed + floor(picture)
    elif stray == "auto" and area is not None:
        removed = stray_light(picture, area)
    advance(0.6)
    halves = merged_half_difference(exposures, darks, noise)
    advance(0.8)
    planes = [None] * len(picture) if halves is None else list(superpixels(halves, first))
    bands = tuple(
        usable_band(plane, pixel_um, variance=own, noise=half)
        for plane, own, half in zip(picture, variance, planes, strict=True)
    )
    psf = picture - removed
    if not float(psf.max()) > 0:
        raise DataError(f"{first.source} shows no light of a point source besides the stray light")
    return PointPsf(
        psf,
        tuple(float(plane.double().mean().sqrt()) for plane in variance),
        noise,
        saturated,
        merged.ratios,
        tuple(removed.double().mean(dim=(-2, -1)).tolist()),
        tuple(floor(picture - removed).flatten().tolist()),
        area,
        bands,
        contrast,
    )


def point_psf_bytes(pixels: int, exposures: int) -> float:
    """Most memory that `point_psf` holds at once, frames of so many pixels included."""
    return pixels * (_BYTES_PER_PIXEL + _BYTES_PER_EXPOSURE * exposures)


def no_point_source(psf: Tensor, source: str) -> str | None:
    """What is said of a picture whose fine structure is not that of a point source; else None."""
    spread, mean, _ = _fine_structure(psf, torch.zeros_like(psf))
    contrast = math.sqrt(spread) / mean if mean > 0 else math.inf
    return _no_point_source(contrast, source) if contrast < _LEAST_CONTRAST else None


def _no_point_source(contrast: float, source: str) -> str:
    return (
        f"{source} shows no point source: its fine structure has a contrast of "
        f"{100 * contrast:.2g} %, as that of a scene or of even light has"
    )


def _fine_structure(picture: Tensor, variance: Tensor) -> tuple[float, float, float]:
    """Mean square of what is finer than `_AROUND` pixels, the mean, and the noise's variance.

    Of the mean over the channels, in which the brighter ones count more.
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
    return spread, float(grey.double().mean()), float(noise.double().mean())


def _contrast(picture: Tensor, variance: Tensor, source: str) -> float:
    """Contrast of the fine structure, which only a point source gives; other light is refused."""
    spread, mean, floor_of_noise = _fine_structure(picture, variance)
    if not (mean > 0 and spread > 2 * floor_of_noise):
        raise DataError(
            f"{source} shows nothing above its noise: a picture of a point source is needed. "
            f"Check the file and its black level, expose longer, take more frames, {_FINISHED}"
        )
    contrast = math.sqrt(spread - floor_of_noise) / mean
    if contrast < _LEAST_CONTRAST:
        raise DataError(
            f"{_no_point_source(contrast, source)}. Take a small light, such as an LED behind a "
            f"pinhole, in a dark room, {_FINISHED}"
        )
    return contrast
