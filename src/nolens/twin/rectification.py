"""A photograph without the shading and the distortion of its camera, by rays through its layers."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.operators import PixelRectangle
from nolens.twin.model import Twin
from nolens.twin.scene import FieldMap

_FAINTEST = 0.05
"""Of the brightest pixel's response: fainter ones are brightened no further than this one."""


@dataclass(frozen=True)
class Rectification:
    r"""What undoes shading and distortion on the pixels of a photograph.

    A pixel of a plane scene gives the light :math:`\cos θ\, dA / z^2` times the vignetting
    (`FieldMap.solid_angle`, `Twin.vignetting`); the picture is divided by that. By Snell's law its
    chief ray, of the sine p, falls at the distance d(p) from the axis (`Stack`); in a picture by
    a pinhole, as large on the axis, it falls at a distance in proportion to tan θ.

    Parameters
    ----------
    twin
        The camera; its relief does not matter.
    rectangle
        Pixels of the photograph, in the sensor's frame.
    bin_by
        So many of the camera's (super)pixels, along a side, are one pixel.
    """

    twin: Twin
    rectangle: PixelRectangle
    bin_by: int = 1

    @property
    def response(self) -> Tensor:
        """Light of every pixel of an even plane, (height, width), 1 for the brightest."""
        field = FieldMap(self.twin, self.rectangle.finer(self.bin_by))
        light = field.solid_angle() * field.vignetting()
        coarse: Tensor = nnf.avg_pool2d(light[None], self.bin_by)[0]
        return coarse / coarse.max()

    def flattened(self, picture: Tensor) -> Tensor:
        """The picture over its response, which counts as a twentieth where it is less."""
        return picture / self.response.clamp_min(_FAINTEST).to(picture)

    def undistorted(self, picture: Tensor) -> Tensor:
        """The picture as a pinhole shows it, cubically interpolated; dark where it shows nothing.

        It reaches as far as the middles of the four edges do, so the corners are cut off.

        Parameters
        ----------
        picture
            (channels, height, width).
        """
        rows, columns = (
            torch.arange(math.ceil(first), math.floor(last) + 1, dtype=torch.float64)
            for first, last in (self._extent(0), self._extent(1))
        )
        across = self.tangent_per_pixel * (rows[:, None].square() + columns.square()).sqrt()
        outside = self.twin.camera.outside
        p = outside * across / (1 + across.square()).sqrt()
        moved = self.twin.stack().displacement_um(p) / self._pixel_um
        scale = torch.where(across > 0, moved * self.tangent_per_pixel / across.clamp_min(1e-12), 1)
        middle, size = self._middle, picture.shape[-2:]
        places = [
            (2 * (each * scale + at) + 1) / count - 1
            for each, at, count in zip((rows[:, None], columns), middle, size, strict=True)
        ]
        grid = torch.stack([places[1], places[0]], dim=-1)[None].to(picture)
        out: Tensor = nnf.grid_sample(picture[None], grid, mode="bicubic", align_corners=False)[0]
        return out.clamp_min(0)

    @property
    def tangent_per_pixel(self) -> float:
        """Tangent of the field angle that a pixel sees on the axis."""
        return self._pixel_um / (self.twin.stack().reduced_um * self.twin.camera.outside)

    def row(self) -> dict[str, float]:
        """How much light the darkest pixel gets, and the scale on the axis, for the record."""
        return {
            "least_response": float(self.response.min()),
            "tangent_per_pixel": self.tangent_per_pixel,
        }

    @property
    def _pixel_um(self) -> float:
        return self.bin_by * self.twin.pixel_um

    @property
    def _middle(self) -> tuple[float, float]:
        """Row and column of the axis, counted from the picture's first pixel."""
        rows, columns = self.twin.shape
        aside = (self.bin_by - 1) / 2
        return (
            (rows // 2 - aside) / self.bin_by - self.rectangle.top,
            (columns // 2 - aside) / self.bin_by - self.rectangle.left,
        )

    def _extent(self, axis: int) -> tuple[float, float]:
        """Where the first and the last pixel on the axis lie in the pinhole's picture."""
        count = (self.rectangle.height, self.rectangle.width)[axis]
        away = torch.tensor([0.0, count - 1], dtype=torch.float64) - self._middle[axis]
        p = self.twin.stack().ray(away.abs() * self._pixel_um) / self.twin.camera.outside
        tangents = p / (1 - p.square()).sqrt() / self.tangent_per_pixel
        first, last = (tangents * away.sign()).tolist()
        return first, last
