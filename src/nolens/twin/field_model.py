"""A simulated camera whose PSFs are computed once, for many scenes of one distance."""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.kernels import irfft2, irfft2_window_, rfft2, rfft2_window
from nolens.optics import MaskSurface, PointSource, Relief
from nolens.progress import ProgressCallback, part_of
from nolens.twin.irradiance import FieldNode, FieldSums
from nolens.twin.light import Light
from nolens.twin.model import Twin
from nolens.twin.psf import sampled, shortest_nm
from nolens.twin.scene import FieldMap, Plane, render_plane


@dataclass(frozen=True)
class FieldModel:
    """What `irradiate` does, its PSFs computed once and stored as spectra.

    Make one with `FieldModel.of`.

    Parameters
    ----------
    twin
        The camera, without its relief, which is needed no more.
    field
        Map of the pixels that scenes fill.
    distance_um
        Of all scenes.
    illuminant
        Spectrum of their white.
    """

    twin: Twin
    field: FieldMap
    distance_um: float
    illuminant: Light
    _weights: Tensor
    _tangents: tuple[Tensor, Tensor]
    _sums: FieldSums
    _spectra: tuple[Tensor, ...]
    """Of every field point: (pixels of a superpixel, rows, half the columns). The first scene
    pixel and the sensor's first pixel that sees it lie at the origin of the FFT grid."""

    @classmethod
    def of(
        cls,
        twin: Twin,
        field: FieldMap,
        *,
        distance_um: float,
        light: Light,
        wavelengths: int = 3,
        field_points: int = 1,
        progress: ProgressCallback | None = None,
    ) -> "FieldModel":
        """Compute the PSFs, for scenes of one distance and light.

        Raises
        ------
        OptionError
            If the distance is beyond the model, light passes beyond the relief, or the field points
            along a side are an even number.
        """
        weights = (field.solid_angle() * field.vignetting()).float()
        sums = FieldSums(twin, field, field_points, nearest_um=distance_um, estimate=False)
        colours = light.colours(twin.quantum_efficiency, twin.camera.sensor.channels, wavelengths)
        sums.twin = sampled(
            twin,
            twin.sensor_pitch_um / sums.per_pixel,
            shortest_nm=shortest_nm(colours),
            distance_um=distance_um,
        )
        spectra, total, done = [], len(sums.nodes) * len(colours), 0
        for node in sums.nodes:
            sums.spectra[1].zero_()
            point = torch.zeros_like(weights)
            point[node.pixel] = 1.0
            for channel, colour in enumerate(colours):
                sums.add(node, channel, point, distance_um, colour, part_of(progress, done, total))
                done += 1
            spectra.append(sums.spectra[1] * _shift(node.pixel, sums.padded))
        flat = MaskSurface(Relief(torch.zeros(2, 2), twin.sensor_pitch_um), twin.mask.opening)
        bare = replace(twin, mask=flat)
        field = replace(field, twin=bare)
        sums.twin, sums.field, sums.spectra = bare, field, {}
        tangents = field.tangents()
        return cls(bare, field, distance_um, light, weights, tangents, sums, tuple(spectra))

    @property
    def response(self) -> Tensor:
        """How much of the light of each scene pixel reaches the sensor, 1 for the most."""
        return self._weights / self._weights.max()

    @property
    def working_bytes(self) -> int:
        """What it holds."""
        return sum(each.numel() * each.element_size() for each in self._spectra)

    def light(self, radiance: Tensor) -> Tensor:
        """Light of a scene on every pixel, as `Irradiated.light`.

        Parameters
        ----------
        radiance
            On the pixels of the field's support, (channels, height, width).
        """
        sums, channels = self._sums, self._channels()
        scene = radiance * self._weights
        total: Tensor | None = None
        for node, spectrum in zip(sums.nodes, self._spectra, strict=True):
            part, corner = sums.weighted(node, scene)
            image = rfft2_window(part, corner, sums.padded)[channels].mul_(spectrum)
            total = image if total is None else total.add_(image)
        assert total is not None
        planes = irfft2_window_(total, (*self._first((0, 0)), *self.twin.shape), sums.padded)
        step, (rows, columns) = self.twin.superpixel, self.twin.shape
        out = torch.empty(rows * step, columns * step)
        for number, plane in enumerate(planes):
            row, column = divmod(number, 2)
            torch.clamp_min(plane, 0, out=out[row::step, column::step])
        return out

    def rendered(self, picture: Tensor, *, whole: bool = True) -> Tensor:
        """A picture on the pixels of the field.

        Parameters
        ----------
        picture
            Linear radiance, (channels, height, width), channels as the sensor has them.
        whole
            As large as it fits in whole, dark beside it; otherwise as small as it covers the field.

        Returns
        -------
        Tensor
            (channels, height, width) of the field's support.
        """
        size = picture.shape[-2:]
        sides = zip(self._half(whole=whole), size, strict=True)
        longer = (min if whole else max)(each * max(size) / side for each, side in sides)
        plane = Plane(picture, 2 * math.degrees(math.atan(longer)), self.distance_um)
        radiance, opacity = render_plane(plane, self._tangents)
        return radiance * opacity

    @property
    def aspect(self) -> float:
        """Height of a picture that fills the field, over its width."""
        height, width = self._half(whole=False)
        return height / width

    def altered(
        self, *, scale: float = 1.0, rotation_rad: float = 0.0, blur_pixels: float = 0.0
    ) -> "FieldModel":
        """The camera with other PSFs: magnified, turned or blurred about their chief rays.

        The PSFs are resampled with cubic interpolation; their light stays the same.

        Parameters
        ----------
        scale
            Factor on their size.
        rotation_rad
            Anticlockwise in the picture.
        blur_pixels
            Standard deviation of a Gaussian, in pixels of the reconstruction.
        """
        spectra = self._spectra
        if scale != 1 or rotation_rad != 0:
            sums = self._sums
            spectra = tuple(
                self._resampled(node, spectrum, scale, rotation_rad)
                for node, spectrum in zip(sums.nodes, spectra, strict=True)
            )
        if blur_pixels > 0:
            rows, columns = self._sums.padded
            squared = (
                torch.fft.fftfreq(rows, dtype=torch.float64)[:, None].square()
                + torch.fft.rfftfreq(columns, dtype=torch.float64).square()
            )
            transfer = torch.exp(-2 * (math.pi * blur_pixels) ** 2 * squared).float()
            spectra = tuple(spectrum * transfer for spectrum in spectra)
        return replace(self, _spectra=spectra)

    def psf(self) -> Tensor:
        """PSF of a point source in the middle of the field.

        Returns
        -------
        Tensor
            (channels, rows, columns), green as the mean of its two pixels. With an
            aperture that leaves room it has the sensor's size, without one as much more as light
            of the field needs.
        """
        sums, number = self._sums, len(self._sums.nodes) // 2
        node = sums.nodes[number]
        planes = irfft2(self._spectra[number], sums.padded).roll(node.pixel, dims=(-2, -1))
        if self.twin.aperture_room_um is None:
            size = [
                count + max(edges.before) + max(edges.after)
                for count, edges in zip(self.twin.shape, sums.edges, strict=True)
            ]
            planes = planes[:, : size[0], : size[1]]
        else:
            first, shape = self._first((0, 0)), self.twin.shape
            planes = planes[:, first[0] : first[0] + shape[0], first[1] : first[1] + shape[1]]
        numbers = torch.tensor(self._channels())
        return torch.stack(
            [planes[numbers == each].mean(dim=0) for each in range(int(numbers.max()) + 1)]
        ).clamp_min_(0)

    def _resampled(
        self, node: FieldNode, spectrum: Tensor, scale: float, rotation_rad: float
    ) -> Tensor:
        """Spectrum of one field point's PSF, magnified and turned about its chief ray."""
        padded, support, shape = self._sums.padded, self.field.support, self.twin.shape
        planes = irfft2(spectrum, padded).roll(node.pixel, dims=(-2, -1))
        # Where the chief ray falls, in pixels of the FFT grid.
        middle = [
            first + corner - count // 2 + (count - 1) / 2
            for first, corner, count in zip(
                self._first(node.pixel), (support.top, support.left), shape, strict=True
            )
        ]
        step = self.twin.superpixel
        cosine, sine = math.cos(rotation_rad) / scale, math.sin(rotation_rad) / scale
        places = [torch.arange(count, dtype=torch.float64) for count in padded]
        resampled = []
        for number, plane in enumerate(planes):
            # A pixel of a superpixel lies a quarter of it beside the superpixel's middle.
            aside = [(2 * each + 1 - step) / (2 * step) for each in divmod(number, 2)]
            centre = [each - by for each, by in zip(middle, aside, strict=True)]
            rows, columns = places[0][:, None] - centre[0], places[1] - centre[1]
            source = (
                centre[0] + cosine * rows + sine * columns,
                centre[1] - sine * rows + cosine * columns,
            )
            at = [(2 * each + 1) / count - 1 for each, count in zip(source, padded, strict=True)]
            resampled.append(
                nnf.grid_sample(
                    plane[None, None],
                    torch.stack([at[1], at[0]], dim=-1).float()[None],
                    mode="bicubic",
                    align_corners=False,
                )[0, 0]
            )
        together = torch.stack(resampled).roll([-each for each in node.pixel], dims=(-2, -1))
        return rfft2(together / scale**2)

    def _half(self, *, whole: bool) -> tuple[float, float]:
        """Tangents of half the height and width of what the field holds, or of what covers it."""
        if not whole:
            return float(self._tangents[0].abs().max()), float(self._tangents[1].abs().max())
        middle = self.field.support.height // 2, self.field.support.width // 2
        return (
            abs(float(self._tangents[0][0, middle[1]])),
            abs(float(self._tangents[1][middle[0], 0])),
        )

    def _first(self, pixel: tuple[int, int]) -> tuple[int, int]:
        """Where the sensor begins in the FFT grid, with a scene pixel at its origin."""
        edges = self._sums.edges
        return max(edges[0].before) + pixel[0], max(edges[1].before) + pixel[1]

    def _channels(self) -> list[int]:
        """Channel of each pixel of a superpixel."""
        mosaic = self.twin.camera.sensor.mosaic
        return [0] if mosaic == "none" else ["RGB".index(colour) for colour in mosaic]


def half_field(twin: Twin, angle_deg: float) -> tuple[float, float]:
    """Tangents of half the height and width of a field: an angle, or what an aperture leaves of it.

    Parameters
    ----------
    twin
        The camera.
    angle_deg
        Field angle along the sensor's longer side, from edge to edge.
    """
    sensor = twin.camera.sensor
    rows, columns = sensor.rows, sensor.columns
    longest = math.tan(math.radians(angle_deg / 2))

    def tangents(longer: float) -> tuple[float, float]:
        return longer * rows / max(rows, columns), longer * columns / max(rows, columns)

    room = twin.aperture_room_um
    if room is None:
        return tangents(longest)
    inside, outside = 0.0, longest
    for _ in range(40):
        middle = (inside + outside) / 2
        shifts = [max(twin.shift_um(PointSource((0.0, tangent)))) for tangent in tangents(middle)]
        if all(shift <= most for shift, most in zip(shifts, room, strict=True)):
            inside = middle
        else:
            outside = middle
    return tangents(outside)


def _shift(pixel: tuple[int, int], padded: tuple[int, int]) -> Tensor:
    """Transfer function that moves a field up and to the left by some pixels."""
    rows = torch.fft.fftfreq(padded[0], dtype=torch.float64) * pixel[0]
    columns = torch.fft.rfftfreq(padded[1], dtype=torch.float64) * pixel[1]
    phase = 2 * math.pi * (rows[:, None] + columns)
    return torch.polar(torch.ones_like(phase), phase).to(torch.complex64)
