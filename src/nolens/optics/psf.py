"""The PSF of a point source at one wavelength, by wave optics, computed in windows."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import fast_length
from nolens.optics.illumination import ChiefRay, Illumination
from nolens.optics.mask import Grid, MaskSurface
from nolens.optics.propagation import propagate
from nolens.progress import ProgressCallback, part_of

_LARGEST = 3072
_FRESNEL_WIDTHS = 3.0
_LARGEST_DIVERGENCE = 0.1
_NODES = 9
# For a sample of the largest window, and of the whole PSF with what is averaged of it.
_BYTES_PER_SAMPLE, _BYTES_PER_RESULT = 14, 6
_MOST_SAMPLES = 10**7


@dataclass(frozen=True)
class Window:
    """One part of the PSF: its first row and column, and those after its last."""

    rows: tuple[int, int]
    columns: tuple[int, int]


@dataclass(frozen=True)
class Margin:
    r"""What a window has around the part that it gives, so that all light of that part is in it.

    Light that the relief turns by Δp moves sideways by Δp · spread; diffraction blurs that by
    some widths of the first Fresnel zone, √(λ · spread). Beyond, the field is faded out over as
    many widths, so that the window's edge diffracts nothing.

    Parameters
    ----------
    geometric_um
        How far the relief turns light aside.
    diffraction_um
        Width that diffraction needs, and width of the fading.
    """

    geometric_um: float
    diffraction_um: float

    @classmethod
    def needed(cls, turned: float, spread_um: float, wavelength_um: float) -> "Margin":
        """Margin for light that is turned by up to `turned` (in p)."""
        zone = math.sqrt(wavelength_um * spread_um)
        return cls(turned * spread_um, _FRESNEL_WIDTHS * zone)

    @property
    def total_um(self) -> float:
        """All of it, on each side."""
        return self.geometric_um + 2 * self.diffraction_um

    def fading(self, samples: int, pitch_um: float, dark_um: float = 0.0) -> Tensor:
        """Weights along one side of a window: 1 inside, falling smoothly to 0 at the edges.

        Or, on both sides, so far before them.
        """
        width = max(1.0, self.diffraction_um / pitch_um)
        place = torch.arange(samples, dtype=torch.float64)
        inside = (torch.minimum(place, samples - 1 - place) - dark_um / pitch_um) / width
        return (0.5 - 0.5 * torch.cos(math.pi * inside.clamp(0, 1))).float()


def divergence(pitch_um: float, distance_um: float) -> float:
    """How far the light of a source spreads, in p, from the middle of a window to its edge."""
    return min(_LARGEST_DIVERGENCE, _LARGEST * pitch_um / distance_um) / 2


def windows(
    rows: int, columns: int, pitch_um: float, distance_um: float, whole: int = 1
) -> Iterator[Window]:
    """Cut a PSF into windows of about equal size, between blocks of `whole`² samples.

    No window is larger than what the processor's caches and the memory like, nor than the fraction
    of the source's distance over which the light's direction changes little.
    """
    largest = _LARGEST
    if math.isfinite(distance_um):
        largest = max(64, min(largest, int(_LARGEST_DIVERGENCE * distance_um / pitch_um)))
    for top, bottom in _cut(rows, largest, whole):
        for left, right in _cut(columns, largest, whole):
            yield Window((top, bottom), (left, right))


def window_length(
    samples: int, margin: Margin, pitch_um: float, *, of_rows: bool, magnification: float = 1.0
) -> int:
    """Length of a transform that holds so many samples and the margin on both sides.

    The light of a near source is spread out behind the margins, too, and wraps around no farther
    than to the samples.
    """
    around = math.ceil((1 + magnification) * margin.total_um / pitch_um)
    return fast_length(samples + around + 2, of_rows=of_rows)


def _cut(count: int, largest: int, whole: int) -> list[tuple[int, int]]:
    parts = -(-count // largest)
    edges = [count // whole * i // parts * whole for i in range(parts + 1)]
    return list(pairwise(edges))


@dataclass(frozen=True)
class Media:
    """What the light goes through at one wavelength.

    Parameters
    ----------
    wavelength_um
        In vacuum.
    above, below
        Refractive indices on the two sides of the mask's surface.
    surfaces
        Indices of all media from air to the last layer, if Fresnel's losses count.
    """

    wavelength_um: float
    above: float
    below: float
    surfaces: tuple[float, ...] = ()

    def coupling(self, squared: Tensor) -> Tensor:
        """Optical path for a unit of relief: n' cos θ' − n cos θ = √(n'² − p²) − √(n² − p²)."""
        near = (self.above**2 - squared).clamp_min(0).sqrt()
        far = (self.below**2 - squared).clamp_min(0).sqrt()
        return far - near


def monochromatic_psf(
    light: Illumination,
    mask: MaskSurface,
    media: Media,
    grid: Grid,
    *,
    response: Callable[[Tensor], Tensor] | None = None,
    progress: ProgressCallback | None = None,
    average: int = 1,
) -> Tensor:
    r"""Irradiance on the sensor of one point source at one wavelength.

    The wave of the source (exact rays) passes the thin relief h, which turns its phase by
    :math:`k_0(\sqrt{n'^2 - p^2} - \sqrt{n^2 - p^2})\,h` with p = n sin θ of the local ray, and then
    the layers (`propagate`). The PSF is cut into windows, each in the frame of its own chief
    ray, so that nothing is sampled but what the relief does to the light; the margin around a
    window follows from geometry.

    Parameters
    ----------
    light
        Source and layers; the layers' indices at this wavelength.
    mask
        Its relief's grid must be a whole multiple of the pitch of `grid`.
    media
        Wavelength, and the indices that the relief lies between.
    grid
        The samples, on the sensor.
    response
        Fraction of the light that a pixel accepts, by p² (float64 tensors).
    progress
        Called with the fraction that is done, 0 to 1, after every window.
    average
        Side of the blocks of samples that the result has means of; the grid holds whole blocks.

    Returns
    -------
    Tensor
        float32, (rows, columns) of the blocks, on the relief's device. It is 1 for a flat mask,
        straight ahead at a source far away; to the side it falls with cos³θ of the local ray (the
        distance to a plane of sources, and the slant of the sensor) and with the response.
    """
    size = grid.rows // average, grid.columns // average
    out = torch.empty(size, device=mask.relief.height_um.device)
    places = grid.positions_um(0), grid.positions_um(1)
    distance_um = light.source.distance_um
    parts = list(windows(grid.rows, grid.columns, grid.pitch_um, distance_um, average))
    for number, part in enumerate(parts):
        rows, columns = (
            slice(first // average, last // average) for first, last in (part.rows, part.columns)
        )
        middle = (part.rows[0] + part.rows[1]) // 2, (part.columns[0] + part.columns[1]) // 2
        chief = light.chief_ray((float(places[0][middle[0]]), float(places[1][middle[1]])))
        seen = _window(light, mask, media, grid, part, middle, chief, response)
        out[rows, columns] = nnf.avg_pool2d(seen[None], average)[0] if average > 1 else seen
        part_of(progress, number, len(parts))(1.0)
    return out


def monochromatic_psf_bytes(
    light: Illumination, mask: MaskSurface, media: Media, grid: Grid, step: int
) -> float:
    """Most memory that `monochromatic_psf` holds at once, its result included.

    The mask may be a patch as steep as all of it; `step` samples of the grid are for one of the
    field behind the relief.
    """
    pitch = step * grid.pitch_um
    turned, spread = _turns(light, mask, media, light.p**2)
    margin = Margin.needed(turned, spread, media.wavelength_um)
    around = 2 * math.ceil(margin.total_um / pitch) * step
    rows, columns = (
        around + _longest(count, grid.pitch_um, light.source.distance_um)
        for count in (grid.rows, grid.columns)
    )
    return rows * columns * _BYTES_PER_SAMPLE + grid.rows * grid.columns * _BYTES_PER_RESULT


def _longest(count: int, pitch_um: float, distance_um: float) -> int:
    """Longest side of the windows along one axis."""
    if count > _MOST_SAMPLES:  # No machine holds so many that counting windows takes long.
        return count
    sides = (part.columns for part in windows(1, count, pitch_um, distance_um))
    return max(last - first for first, last in sides)


def _turns(
    light: Illumination, mask: MaskSurface, media: Media, squared: float
) -> tuple[float, float]:
    """How much the relief turns light of some p², in p, and by how many um each p moves it."""
    p_squared = torch.tensor(squared, dtype=torch.float64)
    spread = float(light.after.spread_um(p_squared.sqrt()))
    return abs(float(media.coupling(p_squared))) * mask.relief.steepest, spread


def _window(
    light: Illumination,
    mask: MaskSurface,
    media: Media,
    grid: Grid,
    part: Window,
    middle: tuple[int, int],
    chief: ChiefRay,
    response: Callable[[Tensor], Tensor] | None,
) -> Tensor:
    relief = mask.relief
    pitch, finer = relief.grid_um, round(relief.grid_um / grid.pitch_um)
    turned, spread = _turns(light, mask, media, chief.squared)
    margin = Margin.needed(turned, spread, media.wavelength_um)
    sides = [stop - start for start, stop in (part.rows, part.columns)]
    magnification = light.magnification(chief)
    size = [
        window_length(
            -(-side // finer), margin, pitch, of_rows=axis == 1, magnification=magnification
        )
        for axis, side in enumerate(sides)
    ]
    # What the samples see of the mask is so many times smaller.
    dark = [
        (1 - 1 / magnification) * side / finer * pitch / 2
        + (magnification - 1) * margin.total_um / 2
        for side in sides
    ]

    nearest, offset, place = [], [], []
    for axis, count in enumerate(relief.height_um.shape):
        index = round(chief.mask_um[axis] / pitch + (count - 1) / 2)
        at = (index - (count - 1) / 2) * pitch
        steps = torch.arange(size[axis], dtype=torch.float64) - size[axis] // 2
        nearest.append(index + steps.to(torch.int64))
        offset.append(chief.mask_um[axis] - at)
        place.append(at + steps * pitch)
    heights = _block(relief.height_um, nearest[0], nearest[1])

    field, divergence = _field(light, mask, media, chief, response, margin, place, heights, dark)
    lateral = turned + divergence + 2 * margin.diffraction_um / spread
    start = [
        finer * (n // 2) + first - at
        for n, (first, _), at in zip(size, (part.rows, part.columns), middle, strict=True)
    ]
    return propagate(
        field,
        pitch,
        light.after,
        media.wavelength_um,
        carrier=chief.p,
        offset_um=(offset[0], offset[1]),
        band_per_um=lateral / media.wavelength_um,
        surfaces=media.surfaces,
        finer=finer,
        window=(start[0], start[1], sides[0], sides[1]),
        squared=True,
    )


def _block(heights: Tensor, rows: Tensor, columns: Tensor) -> Tensor:
    """Part of a surface that goes on level beyond its edges; no copy where it lies within."""
    for axis, places in enumerate((rows, columns)):
        count = heights.shape[axis]
        first, last = int(places[0]), int(places[-1])
        if first >= 0 and last < count:
            heights = heights.narrow(axis, first, len(places))
        else:
            heights = heights.index_select(axis, places.clamp(0, count - 1).to(heights.device))
    return heights


def _field(
    light: Illumination,
    mask: MaskSurface,
    media: Media,
    chief: ChiefRay,
    response: Callable[[Tensor], Tensor] | None,
    margin: Margin,
    place: list[Tensor],
    heights: Tensor,
    dark: list[float],
) -> tuple[Tensor, float]:
    """Field behind the relief without the chief ray's plane wave, and how far its rays diverge.

    Path, amplitude and coupling change so slowly that polynomials through some nodes carry them.
    """
    device = heights.device
    plane = math.isinf(light.source.distance_um)
    nodes, weights = zip(
        *(_interpolation(each, 1 if plane else _NODES) for each in place), strict=True
    )
    p = light.direction(nodes[0][:, None], nodes[1])
    squared = p[0].square() + p[1].square()
    power = light.irradiance(nodes[0][:, None], nodes[1])
    if response is not None:
        power = power * response(squared)

    fading = [
        margin.fading(len(each), mask.relief.grid_um, beside)
        for each, beside in zip(place, dark, strict=True)
    ]

    def everywhere(values: Tensor, faded: bool = False) -> Tensor:
        if plane and not faded:
            return values.float().to(device)
        # From nodes to rows in float64, then to all samples in float32, where the time goes.
        rows, columns = weights[0] @ values, weights[1]
        if faded:
            rows, columns = rows * fading[0][:, None], columns * fading[1][:, None]
        product: Tensor = rows.float().to(device) @ columns.float().to(device).T
        return product

    turns = heights * everywhere(media.coupling(squared) * (2 * math.pi / media.wavelength_um))
    if not plane:
        path = light.path_um(nodes[0][:, None], nodes[1], chief)
        turns += everywhere(path * (2 * math.pi / media.wavelength_um))
    amplitude = everywhere(power.sqrt(), faded=True)
    if mask.opening is not None:
        open_ = mask.opening.coverage(place[0], place[1], mask.relief.grid_um)
        amplitude *= open_.to(device)
    divergence = max(float((part - c).abs().max()) for part, c in zip(p, chief.p, strict=True))
    return torch.polar(amplitude, turns), divergence


def _interpolation(place: Tensor, count: int) -> tuple[Tensor, Tensor]:
    """Chebyshev nodes over an axis, and the matrix from values at them to values everywhere."""
    if count == 1:
        return place.mean()[None], torch.ones((len(place), 1), dtype=torch.float64)
    unit = np.cos(np.pi * (np.arange(count) + 0.5) / count)
    middle, half = float(place[0] + place[-1]) / 2, float(place[-1] - place[0]) / 2
    at = ((place - middle) / half).numpy()
    basis = np.polynomial.chebyshev.chebvander
    matrix = basis(at, count - 1) @ np.linalg.inv(basis(unit, count - 1))
    return torch.from_numpy(middle + half * unit), torch.from_numpy(matrix)
