"""One extended PSF of several that were captured at angles."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from nolens.calibrate.distances import Layers, with_mean_light
from nolens.calibrate.register import Cells
from nolens.calibrate.stitch_place import Placement, place
from nolens.camera.measurement import bin_mean
from nolens.quantities import Angle

STATED_DEG = 3.0
"""Error of an angle that is put up with; half a degree is what a ruler gives."""
_STEEPEST_DEG = 85.0
_LONGEST = 1100
"""Pixels along the longer side for registration, which finds parts of a pixel."""
_NEAR = 0.4
"""How far a view may be from the wanted one, as a fraction of the largest shift, to count much."""
_KNOWN = 0.99
"""Fraction of a line at the edge that must be known."""
_EVEN = 1e-9
"""Weight of a view that is far from the wanted one: enough where it is the only one."""


@dataclass(frozen=True)
class Capture:
    """A PSF as the sensor saw it.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    expected
        (row, column) in pixels by which the light's angle moves the PSF, as far as is known.
    search
        Pixels by which that may be off.
    """

    psf: Tensor
    expected: Cells
    search: float

    @classmethod
    def at_angle(
        cls,
        psf: Tensor,
        angle: tuple[Angle, Angle],
        layers: Layers,
        pixel_um: float,
        *,
        inexact: float = 0.0,
    ) -> "Capture":
        """A PSF with the place where its field angles put it by Snell's law.

        Parameters
        ----------
        psf
            (channels, rows, columns).
        angle
            Of the point source, to the right and up.
        layers
            Of the camera.
        pixel_um
            Distance of the PSF's pixels.
        inexact
            Fraction by which the layers may put the PSF off.
        """
        right, up = layers.shift_um(angle)
        search = 0.0
        if any(each.deg != 0 for each in angle):
            search = (search_um(angle, layers) + inexact * math.hypot(right, up)) / pixel_um
        return cls(psf, (-up / pixel_um, right / pixel_um), search)


def search_um(angle: tuple[Angle, Angle], layers: Layers) -> float:
    """How far the PSF moves with the few degrees by which a stated angle may be off."""
    whole = math.degrees(math.atan(math.hypot(*(math.tan(each.rad) for each in angle))))
    return _reach_um(layers, min(whole + STATED_DEG, _STEEPEST_DEG)) - _reach_um(layers, whole)


def _reach_um(layers: Layers, angle_deg: float) -> float:
    return layers.shift_um((Angle.of(angle_deg, "deg"), Angle.of(0, "deg")))[0]


@dataclass(frozen=True)
class Stitched:
    """A PSF extended beyond the sensor.

    Parameters
    ----------
    psf
        (channels, rows, columns), zero shift in the pixel (rows // 2, columns // 2).
    placement
        Where the captures lie.
    gains
        Brightness of each capture beside the reference's, by channel, in what both show.
    known_share
        Fraction of the pixels that a capture shows; the others have the mean light around them.
    region
        (height, width) of the scene, in pixels around the middle, for which the PSF is known.
    """

    psf: Tensor
    placement: Placement
    gains: tuple[tuple[float, ...], ...]
    known_share: float
    region: tuple[int, int]


def locate(
    captures: list[Capture], reference: int, tick: Callable[[float], None] | None = None
) -> Placement:
    """Find where captures lie against one of them; the first half of `stitch`.

    Parameters
    ----------
    captures
        Alike in size.
    reference
        Number of the one whose light came from straight ahead.
    tick
        Called with the fraction that is done, 0 to 1.
    """
    by = math.ceil(max(captures[0].psf.shape[-2:]) / _LONGEST)
    patterns = [
        bin_mean(each.psf.mean(dim=0, keepdim=True), by)[0].double().numpy() for each in captures
    ]
    found = place(
        patterns,
        [(each.expected[0] / by, each.expected[1] / by) for each in captures],
        reference,
        [each.search / by for each in captures],
        tick,
    )
    return found.scaled(by)


def stitch(
    captures: list[Capture],
    placement: Placement,
    reference: int,
    tick: Callable[[float], None] | None = None,
) -> Stitched:
    r"""Merge captures in the frame of the chief ray.

    The sensor sees of a source whose PSF is moved by s the part :math:`x = u - s` of it, so
    that views from the side show what lies beyond the sensor's edge. Beyond the edge a pixel x of
    the PSF serves only those places of the scene whose light passes there: shifts s with
    :math:`x + s` on the sensor. At each x the views count by how near they are to the middle
    :math:`s^*(x)` of these shifts, since the PSF and its vignetting change with the angle;
    :math:`s^* = 0` for most of the sensor. They fade out towards their own edges, without
    seams. Brightness is brought to the reference's by the least squares of the logarithms of
    the ratios of mean light in all overlaps.

    Parameters
    ----------
    captures
        Alike in size.
    placement
        Where they lie (`locate`), a shift for each.
    reference
        Number of the one whose light came from straight ahead.
    tick
        Called with the share that is done, 0 to 1.
    """
    sensor = (captures[0].psf.shape[-2], captures[0].psf.shape[-1])
    shifts = [each for each in placement.shifts if each is not None]
    assert len(shifts) == len(captures)
    reach = [max(abs(shift[axis]) for shift in shifts) for axis in (0, 1)]
    half = [math.ceil(count / 2) + round(far) for count, far in zip(sensor, reach, strict=True)]
    gains = _gains(captures, placement, reference)
    total = torch.zeros((captures[0].psf.shape[0], 2 * half[0], 2 * half[1]))
    weights = torch.zeros(total.shape[-2:])
    fade = min([far for far in reach if far >= 1], default=1.0)
    for number, (capture, shift, gain) in enumerate(zip(captures, shifts, gains, strict=True)):
        if tick is not None:
            tick(number / len(captures))
        whole = round(shift[0]), round(shift[1])
        moved = _moved(capture.psf, (whole[0] - shift[0], whole[1] - shift[1]))
        top, left = (
            middle - by - count // 2 for middle, by, count in zip(half, whole, sensor, strict=True)
        )
        lines = [
            torch.exp(
                -(((_wanted(count, first, middle, far) - by) / (_NEAR * max(far, 1.0))) ** 2) / 2
            )
            for count, first, middle, far, by in zip(
                sensor, (top, left), half, reach, shift, strict=True
            )
        ]
        weight = (lines[0][:, None] * lines[1] + _EVEN) * _fading(sensor, fade)
        rows, columns = slice(top, top + sensor[0]), slice(left, left + sensor[1])
        total[:, rows, columns] += moved * weight / torch.tensor(gain)[:, None, None]
        weights[rows, columns] += weight
    known = weights > 0
    psf = with_mean_light(total / weights.clamp_min(1e-30), known)
    return Stitched(psf, placement, gains, float(known.double().mean()), _region(known, sensor))


def _region(known: Tensor, sensor: tuple[int, int]) -> tuple[int, int]:
    """Largest scene around the middle whose light reaches the sensor by known cells."""
    rows, columns = known.shape[0] // 2, known.shape[1] // 2
    least = sensor[0] // 2, sensor[1] // 2
    while (rows, columns) != least:
        inner = known.float()[
            known.shape[0] // 2 - rows : known.shape[0] // 2 + rows,
            known.shape[1] // 2 - columns : known.shape[1] // 2 + columns,
        ]
        lines = min(float(inner[0].mean()), float(inner[-1].mean())) if rows > least[0] else 1.0
        sides = (
            min(float(inner[:, 0].mean()), float(inner[:, -1].mean()))
            if columns > least[1]
            else 1.0
        )
        if min(lines, sides) >= _KNOWN:
            break
        if lines <= sides:
            rows -= 1
        else:
            columns -= 1
    return 2 * (rows - least[0]), 2 * (columns - least[1])


def _wanted(count: int, first: int, middle: int, reach: float) -> Tensor:
    """s* along one axis, for the cells of a capture that begins at `first` of the canvas."""
    place = torch.arange(first, first + count, dtype=torch.float32) - middle
    beyond = (place.abs() - (count / 2 - reach)) / 2
    return -place.sign() * beyond.clamp(0, reach)


def _fading(cells: tuple[int, int], along: float) -> Tensor:
    """Weight that rises from nothing at a capture's edge to 1."""
    lines = [torch.minimum(torch.arange(n), torch.arange(n).flip(0)).float() for n in cells]
    return ((torch.minimum(lines[0][:, None], lines[1]) + 0.5) / along).clamp(0, 1)


def _moved(psf: Tensor, part: Cells) -> Tensor:
    """The pattern moved by parts of a cell."""
    planes = [ndimage.shift(plane, part, order=3, mode="nearest") for plane in psf.float().numpy()]
    return torch.from_numpy(np.stack(planes)).clamp_min(0)


def _gains(
    captures: list[Capture], placement: Placement, reference: int
) -> tuple[tuple[float, ...], ...]:
    channels = captures[0].psf.shape[0]
    system: NDArray[np.float64] = np.zeros((len(placement.pairs) + 1, len(captures)))
    ratios = np.zeros((len(placement.pairs) + 1, channels))
    system[-1, reference] = 1.0
    for row, pair in enumerate(placement.pairs):
        moved = round(pair.match.moved[0]), round(pair.match.moved[1])
        one, other = _both(captures[pair.first].psf, captures[pair.second].psf, moved)
        system[row, [pair.first, pair.second]] = -1.0, 1.0
        ratios[row] = (other / one).log().numpy()
    solution = np.exp(np.linalg.lstsq(system, ratios, rcond=None)[0])
    return tuple(tuple(float(value) for value in gain) for gain in solution)


def _both(one: Tensor, other: Tensor, moved: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Mean light of two captures in what both show, by channel; float64."""
    for axis, by in zip((-2, -1), moved, strict=True):
        count = one.shape[axis] - abs(by)
        one = one.narrow(axis, max(0, -by), count)
        other = other.narrow(axis, max(0, by), count)
    means = [each.double().mean(dim=(-2, -1)).clamp_min(1e-300) for each in (one, other)]
    return means[0], means[1]
