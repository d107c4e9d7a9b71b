"""The light of a scene on the sensor, with a point spread function that varies over the field."""

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor

from nolens.camera import Sensor
from nolens.errors import OptionError
from nolens.kernels import fast_length, irfft2, rfft2_window
from nolens.optics import Grid
from nolens.progress import ProgressCallback, part_of
from nolens.twin.light import Colour, Light
from nolens.twin.model import LARGEST_ANGLE_DEG, Twin
from nolens.twin.psf import (
    polychromatic_psf,
    polychromatic_psf_bytes,
    sampled,
    samples_per_pixel,
    shortest_nm,
)
from nolens.twin.scene import FieldMap, Plane, PlaneView

_GREY = ("grey",)
_ARRAYS = 6
"""Arrays of the transforms' size that are held besides the sums."""
_BYTES_PER_PIXEL = 120
"""Held while the directions of the scene pixels are computed."""


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

        The light frees the mean `electrons`, (rows, columns), float64; the noise is shot noise
        and the sensor's read noise.
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
    views: tuple[PlaneView, ...],
    *,
    field_points: int,
    light: Light,
    wavelengths: int = 3,
    progress: ProgressCallback | None = None,
) -> Irradiated:
    r"""Light of a scene on the pixels.

    :math:`y = Σ_k h_k * (w_k x)`: h_k are the point spread functions at a grid of field points,
    each re-centred on its chief ray, w_k are bilinear weights between them, and x is radiance
    times solid angle times vignetting (`Twin.vignetting`), which is not interpolated. Every
    pixel is sampled at its own place in the mosaic. The sum is taken in the Fourier domain; the
    FFT grid holds sensor and patches, so nothing wraps onto the sensor.

    Parameters
    ----------
    twin
        The camera.
    field
        Map of the pixels.
    views
        Of every plane (`render_planes`).
    field_points
        Field points along each side of the scene; odd. One is the shift-invariant model.
    light
        Spectrum of the scene.
    wavelengths
        How many stand for a channel.
    progress
        Called with the fraction that is done, 0 to 1.

    Raises
    ------
    OptionError
        If `field_points` is even or less than 1, or light passes beyond the relief.
    """
    nearest = min(view.distance_um for view in views)
    sums = FieldSums(twin, field, field_points, nearest_um=nearest)
    sums.add_views(views, light, wavelengths, progress)
    return sums.result()


def irradiate_bytes(
    twin: Twin, planes: tuple[Plane, ...], field_points: int, colours: list[Colour]
) -> float:
    """Most memory that `irradiate` holds at once, with the planes rendered for it.

    Parameters
    ----------
    twin
        The camera, as `preview_model` gives it.
    planes
        Of the scene.
    field_points
        Along each side of the scene.
    colours
        Wavelengths and weights of each channel.
    """
    tangents = [max(plane.tangents[axis] for plane in planes) for axis in (0, 1)]
    field = FieldMap.covering(twin, (tangents[0], tangents[1]))
    n = field_points
    sizes = (field.support.height, field.support.width)
    # A PSF is needed as far beside the sensor as its neighbours are away, on both sides; every
    # second one, for the estimate of the error, twice as far.
    beside = [size if n == 1 else 2 * math.ceil(size / (n - 1)) for size in sizes]
    farthest = [step * (1 if n == 1 else 2) for step in beside]
    padded = math.prod(count + step for count, step in zip(twin.shape, farthest, strict=True))
    nearest = min(plane.distance_um for plane in planes)
    psf = polychromatic_psf_bytes(
        twin,
        field.source(sizes[0] // 2, sizes[1] // 2, nearest),
        (twin.shape[0] + beside[0], twin.shape[1] + beside[1]),
        twin.superpixel,
        at_least=_least_samples(twin),
        shortest=shortest_nm(colours),
    )
    spectra = 4 * padded * (twin.superpixel**2 * (1 if n == 1 else 2) + _ARRAYS)
    scene = math.prod(sizes) * (_BYTES_PER_PIXEL + 4 * len(colours) * len(planes))
    return psf + spectra + scene


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


def _least_samples(twin: Twin) -> int:
    """Samples along a sensor pixel at least: one is enough where a mosaic makes superpixels."""
    return 2 if twin.superpixel == 1 else 1


def field_nodes(length: int, count: int) -> list[int]:
    """Pixels of the field points along one side: the middle, or from edge to edge."""
    count = min(count, length - 1 + length % 2)
    if count == 1:
        return [length // 2]
    return [round(i * (length - 1) / (count - 1)) for i in range(count)]


@dataclass(frozen=True)
class _Edges:
    """Pixels beyond the sensor, on both sides, at which the PSF of each node is needed.

    A pixel r before its node (r < 0) sees the sensor's last pixel through the PSF's pixel that lies
    |r| beyond it; so the gap to the node before counts after the sensor, and the other way round.
    """

    before: list[int]
    after: list[int]

    @classmethod
    def of(cls, nodes: list[int], length: int) -> "_Edges":
        """Count them for all nodes of a side with so many pixels."""
        if len(nodes) == 1:
            return cls([length - 1 - nodes[0]], [nodes[0]])
        gaps = [after - before for before, after in pairwise(nodes)]
        return cls([*gaps, 0], [0, *gaps])

    def at(self, index: int) -> tuple[int, int]:
        """Before and after the sensor, for one node."""
        return self.before[index], self.after[index]


def _hat(nodes: list[int], index: int, length: int) -> Tensor:
    """Linear weight of one node: 1 at its pixel, 0 from its neighbours on."""
    if len(nodes) == 1:
        return torch.ones(length)
    pixels = torch.arange(length, dtype=torch.float32)
    rising = torch.ones(length)
    if index > 0:
        rising = (pixels - nodes[index - 1]) / (nodes[index] - nodes[index - 1])
    falling = torch.ones(length)
    if index + 1 < len(nodes):
        falling = (nodes[index + 1] - pixels) / (nodes[index + 1] - nodes[index])
    return torch.minimum(rising, falling).clamp(0, 1)


@dataclass(frozen=True)
class FieldNode:
    """One field point: its number among the rows and columns of them, and its scene pixel."""

    index: tuple[int, int]
    pixel: tuple[int, int]


class FieldSums:
    """Spectra of the sum so far: over all field points and, for an estimate of the error, over
    every second one.
    """

    def __init__(
        self,
        twin: Twin,
        field: FieldMap,
        field_points: int,
        *,
        nearest_um: float,
        estimate: bool = True,
    ) -> None:
        check_field_points(field_points)
        self.twin, self.field = twin, field
        self.per_pixel = samples_per_pixel(
            twin, at_least=_least_samples(twin), distance_um=nearest_um
        )
        support = field.support
        self.at = tuple(
            field_nodes(length, field_points) for length in (support.height, support.width)
        )
        self.nodes = [
            FieldNode((i, j), (row, column))
            for i, row in enumerate(self.at[0])
            for j, column in enumerate(self.at[1])
        ]
        self.steps = (1,) if field_points == 1 or not estimate else (1, 2)
        # What a field point's neighbours see of the sensor lies beyond its own frame.
        self.edges = tuple(
            _Edges.of(axis[:: self.steps[-1]], length)
            for axis, length in zip(self.at, (support.height, support.width), strict=True)
        )
        rows, columns = (
            fast_length(count + max(edges.before) + max(edges.after), of_rows=number == 1)
            for number, (count, edges) in enumerate(zip(twin.shape, self.edges, strict=True))
        )
        self.padded = rows, columns
        mosaic = twin.camera.sensor.mosaic
        self.phases = _GREY if mosaic == "none" else tuple(mosaic)
        size = (len(self.phases), self.padded[0], self.padded[1] // 2 + 1)
        device = twin.mask.relief.height_um.device
        self.spectra = {
            step: torch.zeros(size, dtype=torch.complex64, device=device) for step in self.steps
        }

    def add_views(
        self,
        views: tuple[PlaneView, ...],
        light: Light,
        wavelengths: int,
        progress: ProgressCallback | None,
    ) -> None:
        """Add the light of all planes; parameters and errors as for `irradiate`."""
        twin = self.twin
        weights = (self.field.solid_angle() * self.field.vignetting()).float()
        colours = light.colours(twin.quantum_efficiency, twin.camera.sensor.channels, wavelengths)
        total = len(views) * len(self.nodes) * len(colours)
        done = 0
        for view in views:
            self.twin = sampled(
                twin,
                twin.sensor_pitch_um / self.per_pixel,
                shortest_nm=shortest_nm(colours),
                distance_um=view.distance_um,
            )
            scene = view.radiance * weights
            for node in self.nodes:
                for channel, colour in enumerate(colours):
                    part = part_of(progress, done, total)
                    self.add(node, channel, scene[channel], view.distance_um, colour, part)
                    done += 1

    def add(
        self,
        node: FieldNode,
        channel: int,
        scene: Tensor,
        distance_um: float,
        colour: Colour,
        progress: ProgressCallback,
    ) -> None:
        """Add what the pixels around one field point contribute to one channel."""
        patches = {
            step: self.weighted(node, scene, step)
            for step in self.steps
            if all(index % step == 0 for index in node.index)
        }
        if not any(bool(patch.any()) for patch, _ in patches.values()):
            progress(1.0)
            return
        twin, shape = self.twin, self.twin.shape
        widest = max(patches)
        edges = [
            _Edges.of(axis[::widest], length).at(index // widest)
            for axis, length, index in zip(self.at, scene.shape, node.index, strict=True)
        ]
        source = self.field.source(*node.pixel, distance_um).within(LARGEST_ANGLE_DEG)
        size = [count + sum(edge) for count, edge in zip(shape, edges, strict=True)]
        # A source that was moved in shows its PSF about another place than its pixel's.
        moved = zip(twin.shift_um(source), self.field.place_um(*node.pixel), strict=True)
        centre = [
            (after - before) / 2 * twin.pixel_um + (now - meant)
            for (before, after), (now, meant) in zip(edges, moved, strict=True)
        ]
        grid = Grid(size[0], size[1], twin.pixel_um, (centre[0], centre[1]))
        grid = grid.finer(twin.superpixel * self.per_pixel)
        twin.check_extent(source, grid)
        vignetting = float(twin.vignetting(torch.tensor(twin.p_of(source), dtype=torch.float64)))
        if vignetting == 0:  # No pixel sees this point, but some may see scene pixels beside it.
            twin = twin.accepting_all()
            vignetting = float(
                twin.vignetting(torch.tensor(twin.p_of(source), dtype=torch.float64))
            )
        fine_psf = polychromatic_psf(
            twin, source, grid, colour, progress, average=self.per_pixel
        ).div_(vignetting)
        # The node's own pixel is at the origin of the FFT grid.
        spectra = {
            step: rfft2_window(
                patch.to(fine_psf.device),
                (corner[0] - node.pixel[0], corner[1] - node.pixel[1]),
                self.padded,
            )
            for step, (patch, corner) in patches.items()
        }
        for number, phase in enumerate(self.phases):
            if phase != _GREY[0] and "RGB".index(phase) != channel:
                continue
            row, column = divmod(number, 2)
            step = twin.superpixel
            top, left = (
                max(all_.before) - before
                for all_, (before, _) in zip(self.edges, edges, strict=True)
            )
            psf = fine_psf[row::step, column::step]
            spectrum = rfft2_window(psf, (top, left), self.padded)
            for each, patch in spectra.items():
                self.spectra[each][number].addcmul_(spectrum, patch)

    def result(self) -> Irradiated:
        """Light on the pixels, and how far off it is."""
        light = self._pixels(1)
        error = None
        if len(self.steps) > 1:
            error = float((light - self._pixels(2)).double().square().mean().sqrt()) / 3
        return Irradiated(light, error)

    def _pixels(self, step: int) -> Tensor:
        rows, columns = self.twin.shape
        top, left = (max(edges.before) for edges in self.edges)
        side = self.twin.superpixel
        out = torch.empty(rows * side, columns * side)
        for number in range(len(self.phases)):
            row, column = divmod(number, 2)
            plane = irfft2(self.spectra[step][number], self.padded)
            plane = plane[top : top + rows, left : left + columns].clamp_min(0)
            out[row::side, column::side] = plane.cpu()
        return out

    def weighted(
        self, node: FieldNode, scene: Tensor, step: int = 1
    ) -> tuple[Tensor, tuple[int, int]]:
        """The part of a scene, (…, height, width), that a node has weight for, and its corner."""
        weights = [
            _hat(axis[::step], index // step, length)
            for axis, index, length in zip(self.at, node.index, scene.shape[-2:], strict=True)
        ]
        (top, bottom), (left, right) = (
            (int(each[0]), int(each[-1]) + 1)
            for each in (weight.nonzero().flatten() for weight in weights)
        )
        part = scene[..., top:bottom, left:right]
        return part * weights[0][top:bottom, None] * weights[1][left:right], (top, left)
