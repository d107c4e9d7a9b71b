"""What a scene throws on the sensor, with a point spread function that varies over the field."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.camera import Sensor
from nolens.errors import OptionError
from nolens.kernels import fast_length, irfft2, rfft2
from nolens.optics import Grid
from nolens.twin.blending import Edges, hat, nodes
from nolens.twin.field import FieldMap
from nolens.twin.light import Light
from nolens.twin.model import LARGEST_ANGLE_DEG, Twin
from nolens.twin.point import (
    colour_pattern,
    colour_pattern_bytes,
    sampled,
    samples_per_pixel,
    shortest_nm,
)
from nolens.twin.scene import Plane, Seen

_GREY = ("grey",)
_PERIODS = 6
"""Arrays of the transforms' size that are held besides the sums."""
_BYTES_PER_CELL = 120
"""Held while the cells' directions are found."""


@dataclass(frozen=True)
class Irradiated:
    r"""Light on every pixel of the sensor.

    Parameters
    ----------
    light
        (rows, columns) of pixels, float32: Σ over the pixels of the scene of radiance · solid
        angle in sr; each pixel in the colour that the mosaic gives it.
    field_error
        How far the interpolation between field points is off, as the root mean square over all
        pixels: :math:`\tfrac13` of what every second field point alone would change (bilinear
        interpolation errs with the square of their distance). None for one field point.
    """

    light: Tensor
    field_error: float | None

    def relative_error(self, electrons: Tensor, sensor: Sensor) -> dict[str, float] | None:
        """`field_error` beside the picture's contrast and beside the noise; None if unknown.

        Parameters
        ----------
        electrons
            Mean electrons of every pixel, (rows, columns), float64, that the light frees.
        sensor
            Its read noise is added to the shot noise.
        """
        if self.field_error is None:
            return None
        light = self.light.double()
        noise = math.sqrt(float(electrons.mean()) + sensor.read_noise_electrons**2)
        per_light = float(electrons.square().mean().sqrt()) / max(
            float(light.square().mean().sqrt()), 1e-300
        )
        return {
            "of_contrast": self.field_error / max(float(light.std()), 1e-300),
            "of_noise": self.field_error * per_light / max(noise, 1e-300),
        }


def irradiate(
    twin: Twin,
    field: FieldMap,
    seen: tuple[Seen, ...],
    *,
    field_points: int,
    light: Light,
    wavelengths: int = 3,
    tick: Callable[[float], None] | None = None,
) -> Irradiated:
    r"""Light of a scene on the pixels.

    :math:`y = Σ_k h_k * (w_k x)`: h_k are the point spread functions at a grid of field points,
    each re-centred on its chief ray, w_k are bilinear weights between them, and x is radiance
    times solid angle times vignetting (`Twin.vignetting`), which is not interpolated. Every
    pixel is sampled at its own place in the mosaic. The sum is taken in the Fourier domain; the
    period holds sensor and patches, so nothing wraps onto the sensor.

    Parameters
    ----------
    twin
        The camera.
    field
        Map of the pixels.
    seen
        What the camera sees of every plane (`arrange`).
    field_points
        Field points along each side of the scene; odd. One is the plain convolution model.
    light
        Spectrum of the scene.
    wavelengths
        How many stand for a channel.
    tick
        Called with the fraction that is done, 0 to 1.

    Raises
    ------
    OptionError
        If `field_points` is even or less than 1, or light passes beyond the relief.
    """
    sums = summed(
        twin,
        field,
        seen,
        field_points=field_points,
        light=light,
        wavelengths=wavelengths,
        tick=tick,
    )
    return sums.finish()


def summed(
    twin: Twin,
    field: FieldMap,
    seen: tuple[Seen, ...],
    *,
    field_points: int,
    light: Light,
    wavelengths: int = 3,
    tick: Callable[[float], None] | None = None,
) -> "PatternSums":
    """Spectra of the light on the pixels; parameters and errors as for `irradiate`."""
    check_field_points(field_points)
    pitch = twin.sensor_pitch_um
    if twin.cell_pixels == 1:
        per_pixel = samples_per_pixel(twin, at_least=2)
    else:
        per_pixel = samples_per_pixel(twin, at_least=1)
    work = PatternSums(twin, field, field_points, per_pixel)
    weights = (field.solid_angle() * field.vignetting()).float()
    total = len(seen) * len(work.nodes) * len(twin.camera.sensor.channels)
    colours = [
        light.wavelengths(twin.quantum_efficiency, channel, wavelengths)
        for channel in twin.camera.sensor.channels
    ]
    done = 0
    for plane in seen:
        work.twin = sampled(
            twin,
            pitch / per_pixel,
            shortest_nm=shortest_nm(colours),
            distance_um=plane.distance_um,
        )
        for node in work.nodes:
            for channel, colour in enumerate(colours):

                def part_tick(share: float, before: int = done) -> None:
                    if tick is not None:
                        tick((before + share) / total)

                patch = plane.radiance[channel] * weights
                work.add(node, channel, patch, plane.distance_um, colour, part_tick)
                done += 1
    return work


def irradiate_bytes(
    twin: Twin,
    planes: tuple[Plane, ...],
    field_points: int,
    colours: list[tuple[tuple[float, float], ...]],
) -> float:
    """Most memory that `irradiate` holds at once, with the planes arranged for it.

    Parameters
    ----------
    twin
        The camera, as `nolens.twin.preview.preview_model` gives it.
    planes
        Of the scene.
    field_points
        Along each side of the scene.
    colours
        Wavelengths and weights of each channel.
    """
    tangents = [max(plane.tangents[axis] for plane in planes) for axis in (0, 1)]
    field = FieldMap.covering(twin, (tangents[0], tangents[1]))
    cells, n = twin.cells, field_points
    sizes = (field.region.height, field.region.width)
    # A PSF is needed as far beside the sensor as its neighbours are away, on both sides; every
    # second one, for the estimate of the error, twice as far.
    beside = [size if n == 1 else 2 * math.ceil(size / (n - 1)) for size in sizes]
    farthest = [step * (1 if n == 1 else 2) for step in beside]
    period = math.prod(count + step for count, step in zip(cells, farthest, strict=True))
    nearest = min(plane.distance_um for plane in planes)
    pattern = colour_pattern_bytes(
        twin,
        field.source(sizes[0] // 2, sizes[1] // 2, nearest),
        (cells[0] + beside[0], cells[1] + beside[1]),
        twin.cell_pixels,
        at_least=2 if twin.cell_pixels == 1 else 1,
        shortest=shortest_nm(colours),
    )
    spectra = 4 * period * (twin.cell_pixels**2 * (1 if n == 1 else 2) + _PERIODS)
    scene = math.prod(sizes) * (_BYTES_PER_CELL + 4 * len(colours) * len(planes))
    return pattern + spectra + scene


def check_field_points(field_points: int) -> None:
    """Refuse a number of field points without a middle one.

    Raises
    ------
    OptionError
        If it is even or less than 1.
    """
    if field_points < 1 or field_points % 2 == 0:
        raise OptionError(
            f"{field_points} field points: an odd number along each side is needed, such as 5 or "
            "9; 1 is the plain convolution model"
        )


@dataclass(frozen=True)
class _Node:
    """One field point: its number among the rows and columns of them, and its cell."""

    index: tuple[int, int]
    cell: tuple[int, int]


class PatternSums:
    """Spectra of the sum so far: over all field points, and over every second one."""

    def __init__(self, twin: Twin, field: FieldMap, field_points: int, per_pixel: int) -> None:
        self.twin, self.field, self.per_pixel = twin, field, per_pixel
        region = field.region
        self.at = tuple(nodes(length, field_points) for length in (region.height, region.width))
        self.nodes = [
            _Node((i, j), (row, column))
            for i, row in enumerate(self.at[0])
            for j, column in enumerate(self.at[1])
        ]
        self.steps = (1,) if field_points == 1 else (1, 2)
        # What a field point's neighbours see of the sensor reaches beyond its own frame.
        self.edges = tuple(
            Edges.of(axis[:: self.steps[-1]], length)
            for axis, length in zip(self.at, (region.height, region.width), strict=True)
        )
        rows, columns = (
            fast_length(count + max(edges.before) + max(edges.after), of_rows=number == 1)
            for number, (count, edges) in enumerate(zip(twin.cells, self.edges, strict=True))
        )
        self.period = rows, columns
        mosaic = twin.camera.sensor.mosaic
        self.phases = _GREY if mosaic == "none" else tuple(mosaic)
        spectrum = (self.period[0], self.period[1] // 2 + 1)
        device = twin.mask.relief.height_um.device
        self.sums = {
            step: torch.zeros((len(self.phases), *spectrum), dtype=torch.complex64, device=device)
            for step in self.steps
        }

    def add(
        self,
        node: _Node,
        channel: int,
        scene: Tensor,
        distance_um: float,
        colour: tuple[tuple[float, float], ...],
        tick: Callable[[float], None],
    ) -> None:
        """Add what the pixels around one field point contribute to one channel."""
        patches = {
            step: self._patch(node, scene, step)
            for step in self.steps
            if all(index % step == 0 for index in node.index)
        }
        if all(float(patch.abs().max()) == 0 for patch in patches.values()):
            tick(1.0)
            return
        twin, cells = self.twin, self.twin.cells
        widest = max(patches)
        edges = [
            Edges.of(axis[::widest], length).at(index // widest)
            for axis, length, index in zip(self.at, scene.shape, node.index, strict=True)
        ]
        source = self.field.source(*node.cell, distance_um).within(LARGEST_ANGLE_DEG)
        size = [count + sum(edge) for count, edge in zip(cells, edges, strict=True)]
        # A source that was moved in shows its pattern about another place than its cell's.
        moved = zip(twin.shift_um(source), self.field.place_um(*node.cell), strict=True)
        centre = [
            (after - before) / 2 * twin.cell_um + (now - meant)
            for (before, after), (now, meant) in zip(edges, moved, strict=True)
        ]
        grid = Grid(size[0], size[1], twin.cell_um, (centre[0], centre[1]))
        grid = grid.finer(twin.cell_pixels * self.per_pixel)
        twin.check_reach(source, grid)
        vignetting = float(twin.vignetting(torch.tensor(source.p, dtype=torch.float64)))
        if vignetting == 0:  # No pixel sees this point, but some may see cells beside it.
            twin = twin.accepting_all()
            vignetting = float(twin.vignetting(torch.tensor(source.p, dtype=torch.float64)))
        pattern = colour_pattern(
            twin,
            source,
            grid,
            colour,
            tick,
            average=self.per_pixel,
        ).div_(vignetting)
        spectra = {step: rfft2(patch.to(pattern.device)) for step, patch in patches.items()}
        for number, phase in enumerate(self.phases):
            if phase != _GREY[0] and "RGB".index(phase) != channel:
                continue
            row, column = divmod(number, 2)
            step = twin.cell_pixels
            psf = pattern[row::step, column::step]
            placed = psf.new_zeros(self.period)
            top, left = (
                max(all_.before) - before
                for all_, (before, _) in zip(self.edges, edges, strict=True)
            )
            placed[top : top + size[0], left : left + size[1]] = psf
            spectrum = rfft2(placed)
            for each, patch in spectra.items():
                self.sums[each][number].addcmul_(spectrum, patch)

    def finish(self) -> Irradiated:
        """Light on the pixels, and how far off it is."""
        light = self._pixels(1)
        error = None
        if len(self.steps) > 1:
            error = float((light - self._pixels(2)).double().square().mean().sqrt()) / 3
        return Irradiated(light, error)

    def _pixels(self, step: int) -> Tensor:
        rows, columns = self.twin.cells
        top, left = (max(edges.before) for edges in self.edges)
        per_cell = self.twin.cell_pixels
        out = torch.empty(rows * per_cell, columns * per_cell)
        for number in range(len(self.phases)):
            row, column = divmod(number, 2)
            plane = irfft2(self.sums[step][number], self.period)
            plane = plane[top : top + rows, left : left + columns].clamp_min(0)
            out[row::per_cell, column::per_cell] = plane.cpu()
        return out

    def _patch(self, node: _Node, scene: Tensor, step: int) -> Tensor:
        """The scene times the node's weight, its cell at the origin of the period."""
        weights = [
            hat(axis[::step], index // step, length)
            for axis, index, length in zip(self.at, node.index, scene.shape, strict=True)
        ]
        weighted = scene * weights[0][:, None] * weights[1]
        kept = [each.nonzero().flatten() for each in weights]
        first = [int(each[0]) for each in kept]
        last = [int(each[-1]) + 1 for each in kept]
        part = weighted[first[0] : last[0], first[1] : last[1]]
        placed = scene.new_zeros(self.period)
        rows, columns = (
            (torch.arange(n) + (start - cell)) % period
            for n, start, cell, period in zip(
                part.shape, first, node.cell, self.period, strict=True
            )
        )
        placed[rows[:, None], columns] = part
        return placed
