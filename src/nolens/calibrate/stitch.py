"""One extended PSF of several that were captured at angles: where, how bright, and merged."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import torch
import torch.nn.functional as nnf
from scipy import ndimage
from scipy.sparse.csgraph import connected_components
from torch import Tensor

from nolens.calibrate.distances import Layers, with_mean_light
from nolens.calibrate.registration import Match, Shift, fine_structure, match_overlap
from nolens.camera.measurement import bin_mean
from nolens.errors import DataError, OptionError
from nolens.evaluate.registration import Plane
from nolens.progress import ProgressCallback
from nolens.quantities import Angle

_STATED_DEG = 3.0
"""Error of an angle that is put up with; half a degree is what a ruler gives."""
_STEEPEST_DEG = 85.0
_OFF_DEG = 1.5
_MOST_RESIDUAL = 1.0
_MOST_UNKNOWN = 0.1
_LONGEST = 1100
"""Pixels along the longer side for registration, which finds parts of a pixel."""
_LEAST_ALIKE = 0.25
"""Two captures whose overlap correlates less, each part by its own norm, are not taken for views
of one mask. The 0.3 of the paper's Fig. 6c, which falls with the light too, is no such figure."""
_CHANCE, _SPOT_PIXELS = 6.0, 25
"""PSFs without anything in common may come to that many times 1/√n by their best shift, where
n spots of so many pixels overlap."""
_LEAST_OVERLAP = 0.1
"""Fraction of the sensor that an overlap must have to be compared."""
_ROBUST_PIXELS = 0.5
"""Residual from which on an overlap counts less (Huber's weights)."""
_ROUNDS = 20
_NEAR = 0.4
"""How far a view may be from the best one, as a fraction of the largest shift, to count much."""
_KNOWN = 0.99
"""Fraction of a line at the edge that must be known."""
_SEAM = 0.1
"""Width over which a capture fades into the merged PSF, as a fraction of the sensor's."""
_BLOCKS = 8
"""Along each side of an overlap, about, by whose means brightness is compared."""
_EVEN = 1e-9
"""Weight of a view that is far from the best one: enough where it is the only one."""


@dataclass(frozen=True)
class Capture:
    """A PSF as the sensor captured it.

    Parameters
    ----------
    psf
        (channels, rows, columns).
    expected
        (row, column) in pixels by which the light's angle moves the PSF, as far as is known.
    search
        Pixels by which that may be off.
    name
        For messages.
    angle
        Of the point source, to the right and up.
    pixel_um
        Pitch of the pixels.
    um_per_deg
        How far the PSF moves with the angle, in the mean over the next few degrees.
    """

    psf: Tensor
    expected: Shift
    search: float
    name: str = "a PSF"
    angle: tuple[Angle, Angle] = (Angle("0", "deg"), Angle("0", "deg"))
    pixel_um: float = 1.0
    um_per_deg: float = 1.0

    @classmethod
    def at_angle(
        cls,
        psf: Tensor,
        angle: tuple[Angle, Angle],
        layers: Layers,
        pixel_um: float,
        *,
        name: str,
        inexact: float = 0.0,
    ) -> "Capture":
        """A PSF with the place where its field angles put it by Snell's law.

        `inexact` is the fraction by which the layers may put the PSF off. A few degrees, by which
        a stated angle may be off, are searched.
        """
        right, up = layers.shift_um(angle)
        whole = math.degrees(math.atan(math.hypot(*(math.tan(each.rad) for each in angle))))
        more = min(whole + _STATED_DEG, _STEEPEST_DEG)
        search_um, search = layers.along_um(more) - layers.along_um(whole), 0.0
        if any(each.deg != 0 for each in angle):
            search = (search_um + inexact * math.hypot(right, up)) / pixel_um
        expected = (-up / pixel_um, right / pixel_um)
        return cls(psf, expected, search, name, angle, pixel_um, search_um / _STATED_DEG)


@dataclass(frozen=True)
class Placement:
    """Where captures lie.

    Parameters
    ----------
    shifts
        (row, column) in pixels of every PSF against the reference's.
    correlations
        Of each with the others, at best.
    overlaps
        What the shifts were solved from: for two captures, by number, where the second lies
        against the first.
    residual
        Root mean square, in pixels, by which the overlaps disagree with the shifts.
    """

    shifts: tuple[Shift, ...]
    correlations: tuple[float, ...]
    overlaps: Mapping[tuple[int, int], Match]
    residual: float


def locate(
    captures: list[Capture], reference: int, progress: ProgressCallback | None = None
) -> Placement:
    r"""Find where captures lie against one of them; the first half of `stitch`.

    Every two that overlap are matched (`match_overlap`). Then all shifts s are solved together:
    the least :math:`\sum_{ij} w_{ij} |s_j - s_i - d_{ij}|^2` (`preibisch2009`), with weights of
    the squared correlation, and less for overlaps that contradict the others (`huber1964`).
    `reference` is the number of the capture from straight ahead.

    Raises
    ------
    DataError
        If one is dark, has another size than the others, or fits none of them.
    """
    _check(captures)
    bin_by = math.ceil(max(captures[0].psf.shape[-2:]) / _LONGEST)
    structures = [
        fine_structure(bin_mean(each.psf.mean(dim=0, keepdim=True), bin_by)[0].double().numpy())
        for each in captures
    ]
    rows, columns = structures[0].shape
    candidates: dict[tuple[int, int], Shift] = {}
    for first, second in combinations(range(len(captures)), 2):
        row, column = (
            b / bin_by - a / bin_by
            for a, b in zip(captures[first].expected, captures[second].expected, strict=True)
        )
        overlap = max(0.0, rows - abs(row)) * max(0.0, columns - abs(column))
        if overlap >= _LEAST_OVERLAP * rows * columns:
            candidates[first, second] = row, column
    correlations = [0.0] * len(captures)
    overlaps: dict[tuple[int, int], Match] = {}
    for number, ((first, second), expected) in enumerate(candidates.items()):
        search = captures[first].search / bin_by + captures[second].search / bin_by
        match = match_overlap(structures[first], structures[second], expected, search)
        if match is not None:
            for each in (first, second):
                correlations[each] = max(correlations[each], match.correlation)
            by_chance = _CHANCE * math.sqrt(_SPOT_PIXELS / match.pixels)
            if match.correlation >= max(_LEAST_ALIKE, by_chance):
                overlaps[first, second] = match
        if progress is not None:
            progress((number + 1) / len(candidates))
    links = np.zeros((len(captures), len(captures)))
    for both in overlaps:
        links[both] = 1
    part = connected_components(links, directed=False)[1]
    for number, capture in enumerate(captures):
        if part[number] != part[reference]:
            raise DataError(
                f"{capture.name} does not fit the others: where it should overlap them by its "
                f"angle ({capture.angle[0]}, {capture.angle[1]}), the best correlation is "
                f"{correlations[number]:.2f}. Its angle or its sign is wrong, or it is of another "
                "camera: calibrate it again, or leave it out"
            )
    shifts, residual = _solved(overlaps, len(captures), reference)
    return Placement(
        tuple((bin_by * row, bin_by * column) for row, column in shifts.tolist()),
        tuple(correlations),
        {both: match.scaled(bin_by) for both, match in overlaps.items()},
        bin_by * residual,
    )


def _check(captures: list[Capture]) -> None:
    """Refuse PSFs of several sizes, and dark ones."""
    first = captures[0]
    for each in captures:
        if each.psf.shape != first.psf.shape:
            raise DataError(
                f"{each.name} has {each.psf.shape[-2]}×{each.psf.shape[-1]} pixels, but "
                f"{first.name} {first.psf.shape[-2]}×{first.psf.shape[-1]}: stitch PSFs of one "
                "camera and setting; calibrate the other one again"
            )
        if not float(each.psf.sum()) > 0:
            raise DataError(f"{each.name} is dark: calibrate it again")


def _solved(
    overlaps: Mapping[tuple[int, int], Match], count: int, reference: int
) -> tuple[Plane, float]:
    """Shift of each capture, (captures, 2), and the weighted residual of the overlaps."""
    shifts = np.zeros((count, 2))
    free = np.arange(count) != reference
    system = _differences(overlaps, count)[:, free]
    measured = np.array([match.shift for match in overlaps.values()])
    trust = np.array([match.correlation**2 for match in overlaps.values()])
    weights = trust
    for _ in range(_ROUNDS):
        root = np.sqrt(weights)[:, None]
        shifts[free] = np.linalg.lstsq(system * root, measured * root, rcond=None)[0]
        off = np.hypot(*(system @ shifts[free] - measured).T)
        weights = trust * np.minimum(1.0, _ROBUST_PIXELS / np.maximum(off, 1e-9))
    return shifts, float(np.sqrt((weights * off**2).sum() / weights.sum()))


def _differences(overlaps: Mapping[tuple[int, int], Match], count: int) -> Plane:
    """Matrix that takes values of the captures to their differences in the overlaps."""
    system = np.zeros((len(overlaps), count))
    for row, both in enumerate(overlaps):
        system[row, both] = -1.0, 1.0
    return system


@dataclass(frozen=True)
class Stitched:
    """A PSF extended beyond the sensor.

    Parameters
    ----------
    psf
        (channels, rows, columns), zero shift in the pixel (rows // 2, columns // 2).
    captures, placement, reference
        What it was merged from, where they lie, and the number of the one from straight ahead.
    gains
        Brightness of each capture beside the reference's, by channel, in what both show.
    known_fraction
        Fraction of the pixels that a capture shows; the others have the mean light around them.
    support
        (height, width) of the scene, in pixels around the middle, for which the PSF is known.
    """

    psf: Tensor
    captures: list[Capture]
    placement: Placement
    reference: int
    gains: tuple[tuple[float, ...], ...]
    known_fraction: float
    support: tuple[int, int]

    def at_captures(self) -> Iterator[Tensor]:
        r"""PSFs of the angles of all captures, each about its chief ray, as bright as each other.

        Each is its own light where the sensor saw it, and without a seam that of the others beyond.
        A near source at an angle lights the sensor unevenly, by some per cent: in the logarithm of
        the brightness a plane over the PSF, of which overlaps tell the differences. The others are
        merged with their planes taken away, and get that of the angle.
        """
        planes = _planes(self.captures, self.placement, self.reference)
        shifts = self.placement.shifts
        level = with_mean_light(*_merged(self.captures, shifts, planes))
        middle = level.shape[-2] // 2, level.shape[-1] // 2
        everywhere = slice(0, level.shape[-2]), slice(0, level.shape[-1])
        for capture, shift, plane in zip(self.captures, shifts, planes, strict=True):
            moved, window = _about_chief_ray(capture.psf, shift, middle)
            slope = plane * torch.tensor([0.0, 1.0, 1.0])
            psf = level * _brightness(slope, everywhere, middle)
            own = psf[:, *window]
            size = own.shape[-2], own.shape[-1]
            gain = plane[:, 0].exp().float()[:, None, None]
            own += _fade(size, _SEAM * min(size)) * (moved / gain - own)
            yield psf

    def angle(self, number: int, layers: Layers) -> tuple[Angle, Angle]:
        """Field angles of one capture, by where its light falls."""
        row, column = self.placement.shifts[number]
        pixel_um = self.captures[number].pixel_um
        return layers.angle_at((column * pixel_um, -row * pixel_um))

    def figures(self) -> dict[str, Any]:
        """Figures in values that JSON has; lengths and angles to the right and up."""
        return {
            "sensor_pixels": list(self.captures[0].psf.shape[-2:]),
            "pixels": list(self.psf.shape[-2:]),
            "support": list(self.support),
            "known_fraction": round(self.known_fraction, 6),
            "residual_pixels": round(self.placement.residual, 4),
            "captures": [self._capture_figures(number) for number in range(len(self.captures))],
        }

    def _capture_figures(self, number: int) -> dict[str, Any]:
        capture, shift = self.captures[number], self.placement.shifts[number]
        pixel = capture.pixel_um
        stated = capture.expected[1] * pixel, -capture.expected[0] * pixel
        measured = shift[1] * pixel, -shift[0] * pixel
        off = math.dist(stated, measured)
        return {
            "file": capture.name,
            "angle": [str(each) for each in capture.angle],
            "stated_shift_um": [round(each, 2) + 0.0 for each in stated],
            "shift_um": [round(each, 2) + 0.0 for each in measured],
            "off_um": round(off, 2),
            "off_deg": round(off / capture.um_per_deg, 3),
            "gain": [round(each, 5) for each in self.gains[number]],
            "correlation": round(self.placement.correlations[number], 5),
        }

    def warnings(self) -> list[str]:
        """What may make the PSF worse than it could be."""
        texts = [
            f"{row['file']} lies {row['off_um']:.0f} µm beside where its angle of "
            f"{', '.join(row['angle'])} puts it, about {row['off_deg']:.1f}°: check the angle, and "
            "the layers of the camera if others are off alike"
            for row in self.figures()["captures"]
            if row["off_deg"] > _OFF_DEG
        ]
        if self.placement.residual > _MOST_RESIDUAL:
            texts.append(
                f"the overlaps disagree by {self.placement.residual:.1f} pixels about where the "
                "PSFs lie: was the camera moved or turned between the captures?"
            )
        if 0 in self.support:
            texts.append(
                "no scene around the middle has its whole PSF captured: capture the opposite "
                "angles too, and the corners"
            )
        if self.known_fraction < 1 - _MOST_UNKNOWN:
            texts.append(
                f"{100 * (1 - self.known_fraction):.0f} % of the stitched PSF is in none of the "
                "captures, and has the mean light around it: capture more angles, also in the "
                "corners"
            )
        return texts


def stitch(
    captures: list[Capture],
    placement: Placement,
    reference: int,
    progress: ProgressCallback | None = None,
) -> Stitched:
    r"""Merge captures in the frame of the chief ray.

    The sensor sees of a source whose PSF is moved by s the part :math:`x = u - s` of it, so
    that views from the side show what lies beyond the sensor's edge. Beyond the edge a pixel x of
    the PSF serves only those places of the scene whose light passes there: shifts s with
    :math:`x + s` on the sensor. At each x the views count by how near they are to the middle
    :math:`s^*(x)` of these shifts, since the PSF and its vignetting change with the angle;
    :math:`s^* = 0` for most of the sensor. They fade out towards their own edges, without
    seams. Brightness is brought to the reference's by the least squares of the logarithms of
    the ratios of mean light in all overlaps. `reference` is the number of the capture from
    straight ahead.
    """
    sensor = (captures[0].psf.shape[-2], captures[0].psf.shape[-1])
    gains = _gains(captures, placement, reference)
    planes = nnf.pad(torch.tensor(gains, dtype=torch.float64).log()[..., None], (0, 2))
    total, known = _merged(captures, placement.shifts, planes, progress)
    psf = with_mean_light(total, known)
    fraction = float(known.double().mean())
    return Stitched(psf, captures, placement, reference, gains, fraction, _support(known, sensor))


def _merged(
    captures: list[Capture],
    shifts: tuple[Shift, ...],
    planes: Tensor,
    progress: ProgressCallback | None = None,
) -> tuple[Tensor, Tensor]:
    """Captures, each divided by its brightness, as one PSF; and which of its pixels are known."""
    sensor = (captures[0].psf.shape[-2], captures[0].psf.shape[-1])
    extent = [max(abs(shift[axis]) for shift in shifts) for axis in (0, 1)]
    rows_half, columns_half = (
        math.ceil(count / 2) + round(far) for count, far in zip(sensor, extent, strict=True)
    )
    half = rows_half, columns_half
    total = torch.zeros((captures[0].psf.shape[0], 2 * half[0], 2 * half[1]))
    weights = torch.zeros(total.shape[-2:])
    fade = min([far for far in extent if far >= 1], default=1.0)
    for number, (capture, shift, plane) in enumerate(zip(captures, shifts, planes, strict=True)):
        if progress is not None:
            progress(number / len(captures))
        moved, window = _about_chief_ray(capture.psf, shift, half)
        lines = [
            torch.exp(
                -(((_best_shift(count, first, middle, far) - by) / (_NEAR * max(far, 1))) ** 2) / 2
            )
            for count, first, middle, far, by in zip(
                sensor, (window[0].start, window[1].start), half, extent, shift, strict=True
            )
        ]
        weight = (lines[0][:, None] * lines[1] + _EVEN) * _fade(sensor, fade)
        total[:, *window] += moved * weight / _brightness(plane, window, half)
        weights[window] += weight
    return total / weights.clamp_min(1e-30), weights > 0


def _brightness(plane: Tensor, window: tuple[slice, slice], middle: tuple[int, int]) -> Tensor:
    """Brightness on rows and columns of a PSF, by the plane of its logarithm in each channel."""
    rows, columns = (
        torch.arange(part.start, part.stop, dtype=torch.float64) - half
        for part, half in zip(window, middle, strict=True)
    )
    constant, down, right = plane.double().mT[..., None, None]
    logarithm: Tensor = constant + down * rows[:, None] + right * columns
    return logarithm.exp().float()


def stitch_at_angles(
    captures: list[Capture],
    locating: ProgressCallback | None = None,
    merging: ProgressCallback | None = None,
) -> Stitched:
    """Locate captures (`locate`) against the one from straight ahead, and merge them (`stitch`).

    Raises
    ------
    OptionError
        If there is none from straight ahead, or no other one.
    DataError
        If they do not fit together.
    """
    ahead = [
        number
        for number, capture in enumerate(captures)
        if all(each.deg == 0 for each in capture.angle)
    ]
    if not ahead or len(captures) < 2:
        raise OptionError(
            "give one PSF of a source straight ahead, ('0deg', '0deg'), and others at angles"
        )
    placement = locate(captures, ahead[0], locating)
    return stitch(captures, placement, ahead[0], merging)


def _support(known: Tensor, sensor: tuple[int, int]) -> tuple[int, int]:
    """Largest scene around the middle whose light reaches the sensor by known pixels."""
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


def _best_shift(count: int, first: int, middle: int, extent: float) -> Tensor:
    """s* along one axis, for the pixels of a capture that begins at `first` of the canvas."""
    place = torch.arange(first, first + count, dtype=torch.float32) - middle
    beyond = (place.abs() - (count / 2 - extent)) / 2
    return -place.sign() * beyond.clamp(0, extent)


def _fade(size: tuple[int, int], along: float) -> Tensor:
    """Weight that rises from nothing at a capture's edge to 1."""
    lines = [torch.minimum(torch.arange(n), torch.arange(n).flip(0)).float() for n in size]
    return ((torch.minimum(lines[0][:, None], lines[1]) + 0.5) / along).clamp(0, 1)


def _about_chief_ray(
    psf: Tensor, shift: Shift, middle: tuple[int, int]
) -> tuple[Tensor, tuple[slice, slice]]:
    """A capture by whole pixels of a PSF about its chief ray, and its rows and columns there."""
    whole = round(shift[0]), round(shift[1])
    rows, columns = (
        slice(first := half - by - count // 2, first + count)
        for half, by, count in zip(middle, whole, psf.shape[-2:], strict=True)
    )
    return _shifted(psf, (whole[0] - shift[0], whole[1] - shift[1])), (rows, columns)


def _shifted(psf: Tensor, part: Shift, order: int = 3) -> Tensor:
    """The PSF moved by parts of a pixel, by splines of an order.

    They undershoot beside sharp spots: cut off at zero there would be more light.
    """
    planes = [
        ndimage.shift(plane, part, order=order, mode="nearest") for plane in psf.float().numpy()
    ]
    return torch.from_numpy(np.stack(planes))


def _gains(
    captures: list[Capture], placement: Placement, reference: int
) -> tuple[tuple[float, ...], ...]:
    """Brightness of each capture beside the reference's, by channel, from all overlaps."""
    count, channels = len(captures), captures[0].psf.shape[0]
    ratios = []
    for (first, second), match in placement.overlaps.items():
        shift = round(match.shift[0]), round(match.shift[1])
        one, other = _mean_light(captures[first].psf, captures[second].psf, shift)
        ratios.append((other / one).log().numpy())
    system = np.vstack([_differences(placement.overlaps, count), np.eye(count)[reference]])
    solution = np.exp(
        np.linalg.lstsq(system, np.stack([*ratios, np.zeros(channels)]), rcond=None)[0]
    )
    return tuple(tuple(gain) for gain in solution.tolist())


def _planes(captures: list[Capture], placement: Placement, reference: int) -> Tensor:
    r"""Logarithm of the brightness of each capture beside the reference's, as a plane over the PSF.

    (captures, channels, 3): at the PSF's middle, and per row and column. A near source at an angle
    lights one side more, in proportion to the angle: slopes are the shifts by one factor for all.
    In every overlap the light that two captures i, j show of the same blocks x, levelled, has to
    agree in its mean and in its slopes: :math:`\sum_x (1, x) (l_j(x) e^{-p_j(x)} -
    l_i(x) e^{-p_i(x)}) = 0`. Logarithms of blocks would be biased where patterns differ in
    contrast. Large overlaps whose patterns are alike count most.
    """
    count, channels = len(captures), captures[0].psf.shape[0]
    longest = max(captures[0].psf.shape[-2:])
    shifts = torch.tensor(placement.shifts, dtype=torch.float64) / longest
    overlaps, systems = [], []
    for (first, second), match in placement.overlaps.items():
        place, lights = _blocks(captures, placement, first, second)
        trust = match.pixels * match.correlation**2
        overlaps.append((first, second, place, lights, trust))
        system = torch.zeros(len(place), count + 1, dtype=torch.float64)
        system[:, first], system[:, second] = -trust, trust
        system[:, count] = trust * (place @ (shifts[second] - shifts[first]))
        systems.append(system)
    constants = torch.zeros(count, channels, dtype=torch.float64)
    factor = constants.new_zeros(())
    if not systems:
        return nnf.pad(constants[..., None], (0, 2))
    free = [number for number in range(count) if number != reference]
    system = torch.cat(systems)[:, [*free, count]]
    for _ in range(_ROUNDS):
        left = []
        for first, second, place, lights, trust in overlaps:
            one, other = (
                light * (-constants[each] - factor * (place @ shifts[each])[:, None]).exp()
                for each, light in zip((first, second), lights, strict=True)
            )
            left.append(trust * (other - one) / ((one + other).mean(dim=0) / 2))
        rest = torch.cat(left)
        step = torch.linalg.lstsq(system, rest.mean(dim=1, keepdim=True)).solution[-1, 0]
        rest -= step * system[:, -1:]
        constants[free] += torch.linalg.lstsq(system[:, :-1], rest).solution
        factor = factor + step
    slopes = (factor * shifts / longest)[:, None].expand(-1, channels, -1)
    return torch.cat([constants[..., None], slopes], dim=2)


def _blocks(
    captures: list[Capture], placement: Placement, first: int, second: int
) -> tuple[Tensor, list[Tensor]]:
    """Blocks of an overlap: places in the PSF, and what two captures show there.

    Places, (blocks, 2), are counted from the PSF's middle, in longer sides of the sensor; lights
    are (blocks, channels).
    """
    sides = captures[0].psf.shape[-2:]
    by = placement.overlaps[first, second].shift
    shift = round(by[0]), round(by[1])
    moved = _shifted(captures[second].psf, (shift[0] - by[0], shift[1] - by[1]), order=1)
    parts = _overlap(captures[first].psf, moved, shift)
    size = [max(1, length // _BLOCKS) for length in parts[0].shape[-2:]]
    means = [nnf.avg_pool2d(each.double(), size) for each in parts]
    rows, columns = (
        (torch.arange(n, dtype=torch.float64) + 0.5) * length + max(0, -by) - at - side / 2
        for n, length, by, at, side in zip(
            means[0].shape[-2:], size, shift, placement.shifts[first], sides, strict=True
        )
    )
    lights = [each.flatten(1).T for each in means]
    return torch.cartesian_prod(rows, columns) / max(sides), lights


def _mean_light(one: Tensor, other: Tensor, shift: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """Mean light of two captures in their overlap, by channel; float64."""
    means = [
        each.double().mean(dim=(-2, -1)).clamp_min(1e-300) for each in _overlap(one, other, shift)
    ]
    return means[0], means[1]


def _overlap(one: Tensor, other: Tensor, shift: tuple[int, int]) -> tuple[Tensor, Tensor]:
    """What two captures show of the same part of the PSF."""
    for axis, by in zip((-2, -1), shift, strict=True):
        count = one.shape[axis] - abs(by)
        one = one.narrow(axis, max(0, -by), count)
        other = other.narrow(axis, max(0, by), count)
    return one, other
