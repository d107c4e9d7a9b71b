"""Scenes: directions of the scene pixels, and pictures at distances, nearer before farther ones."""

import math
from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin.model import LARGEST_ANGLE_DEG, Twin

_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear sRGB (IEC 61966-2-1)."""
_FAINTEST = 0.01
"""Of the light of the axis, that from the largest angle."""
_ANGLES_DEG = torch.linspace(0, 89.9, 900, dtype=torch.float64)
_ASTRAY_DEG = 5.0
"""Between the axis and the point source that a PSF was captured of, at most."""
_NEAREST_UM = 10e3
"""Of scenes whose distance is not stated."""


def acceptance_support(twin: Twin, distance_um: float | None = None) -> PixelRectangle:
    r"""Pixels of the reconstruction whose light a camera accepts.

    Rays are refracted towards the axis, and pixels accept little from the side. So little light
    comes from beyond the displacement of the chief ray at the largest angle from which a hundredth
    of the axis's light or more is measured (`Twin.vignetting`). Added to that are the displacement
    at 5°, as far as the source of a PSF may have been off the axis, and :math:`s D / z`: rays that
    meet the mask half a sensor s from its middle come from other angles than the chief ray, behind
    layers of the reduced thickness D.

    Parameters
    ----------
    twin
        The camera.
    distance_um
        Of the nearest thing in the scene, z; None takes 1 cm.
    """
    stack, outside = twin.stack(), twin.camera.outside
    sines = outside * torch.deg2rad(_ANGLES_DEG).sin()
    sines = sines[sines < stack.critical]
    seen = sines[twin.vignetting(sines) >= _FAINTEST]
    astray = sines[_ANGLES_DEG[: len(sines)] <= _ASTRAY_DEG]
    near = stack.reduced_um / (distance_um or _NEAREST_UM)
    reach_um = sum(float(stack.displacement_um(each[-1])) for each in (seen, astray))
    rows, columns = (
        2 * math.ceil(reach_um / twin.pixel_um + near * side / 2) for side in twin.shape
    )
    return PixelRectangle.centred(rows, columns, twin.shape)


@dataclass(frozen=True)
class FieldMap:
    """Pixels of the reconstruction as directions.

    Pixel (i, j) is the one whose chief ray, through the middle of the camera, falls on sensor
    pixel (i, j); (rows // 2, columns // 2) lies on the axis.

    Parameters
    ----------
    twin
        The camera.
    support
        The pixels that the scene fills.
    """

    twin: Twin
    support: PixelRectangle

    @classmethod
    def covering(cls, twin: Twin, tangents: tuple[float, float]) -> "FieldMap":
        """The map of a scene; the tangents are of the field angles of half its height and width.

        Raises
        ------
        OptionError
            If a corner of the scene is beyond the model.
        """
        corner = PointSource(tangents)
        if corner.angle_deg > LARGEST_ANGLE_DEG:
            scale = math.tan(math.radians(LARGEST_ANGLE_DEG)) / math.hypot(*tangents)
            full = 2 * math.degrees(math.atan(scale * max(tangents)))
            raise OptionError(
                f"the scene's corners are {corner.angle_deg:.1f} deg off the axis; the model holds "
                f"to {LARGEST_ANGLE_DEG:g} deg: choose an angle of at most "
                f"{math.floor(full * 10) / 10:g}deg for this scene"
            )
        counts = []
        for tangent in tangents:
            shift = max(twin.shift_um(PointSource((0.0, tangent))))
            counts.append(2 * max(1, math.ceil(shift / twin.pixel_um)))
        return cls(twin, PixelRectangle.centred(counts[0], counts[1], twin.shape))

    def tangents(self) -> tuple[Tensor, Tensor]:
        """Tangents of the field angle of every pixel, two of (height, width), float64."""
        rows, columns = self._displacements()
        tangent_per_um = self._tangent_per_um(self._sines)
        return rows[:, None] * tangent_per_um, columns * tangent_per_um

    def solid_angle(self) -> Tensor:
        r"""Give cos θ · dA / z² of every pixel, for a plane scene of which it shows the area dA.

        With :math:`t = \tan θ` and the displacement d, dA / z² is :math:`(t/d)(dt/dd)` times the
        pixel's area. Times `Twin.vignetting` this is the pixel's irradiance to its radiance.
        """
        p = self._sines
        outside = self.twin.camera.outside
        cosine = (1 - (p / outside).square()).sqrt()
        slope = cosine.pow(-3) / outside / self.twin.stack().spread_um(p)
        return cosine * self._tangent_per_um(p) * slope * self.twin.pixel_um**2

    def vignetting(self) -> Tensor:
        """`Twin.vignetting` of every pixel."""
        return self.twin.vignetting(self._sines)

    def place_um(self, row: int, column: int) -> tuple[float, float]:
        """Where the chief ray of one pixel, counted from the support's first, falls."""
        sensor, step = self.twin.shape, self.twin.pixel_um
        return (
            (self.support.top + row - sensor[0] // 2) * step,
            (self.support.left + column - sensor[1] // 2) * step,
        )

    def source(self, row: int, column: int, distance_um: float) -> PointSource:
        """The point source of one pixel, counted from the support's first."""
        place = self.place_um(row, column)
        displacement = math.hypot(*place)
        if displacement == 0:
            return PointSource((0.0, 0.0), distance_um)
        p = float(self.twin.stack().ray(torch.tensor(displacement, dtype=torch.float64)))
        tangent = p / math.sqrt(self.twin.camera.outside**2 - p * p) / displacement
        return PointSource((place[0] * tangent, place[1] * tangent), distance_um)

    def _displacements(self) -> tuple[Tensor, Tensor]:
        """Of every row and column, from the axis, in um."""
        sensor, support = self.twin.shape, self.support
        rows = torch.arange(support.height, dtype=torch.float64) + (support.top - sensor[0] // 2)
        columns = torch.arange(support.width, dtype=torch.float64) + (support.left - sensor[1] // 2)
        return rows * self.twin.pixel_um, columns * self.twin.pixel_um

    def _displacement(self) -> Tensor:
        """Of every pixel."""
        rows, columns = self._displacements()
        return (rows.square()[:, None] + columns.square()).sqrt()

    @cached_property
    def _sines(self) -> Tensor:
        """P of every pixel."""
        return self.twin.stack().ray(self._displacement())

    def _tangent_per_um(self, p: Tensor) -> Tensor:
        """Tan θ over the displacement; on the axis its limit."""
        displacement = self._displacement()
        outside = self.twin.camera.outside
        tangent = p / (outside**2 - p * p).sqrt()
        straight = self.twin.stack().reduced_um * outside
        return torch.where(displacement > 0, tangent / displacement.clamp_min(1e-9), 1 / straight)


@dataclass(frozen=True)
class Plane:
    """A picture that stands parallel to the sensor, its middle on the axis.

    Parameters
    ----------
    radiance
        Linear, (channels, height, width), 1 is white; channels as the sensor has them.
    angle_deg
        Field angle that the longer side fills, from edge to edge.
    distance_um
        From the camera; may be infinite.
    opacity
        (height, width), 1 where the picture hides what is behind it; None: everywhere.
    """

    radiance: Tensor
    angle_deg: float
    distance_um: float
    opacity: Tensor | None = None

    @property
    def tangents(self) -> tuple[float, float]:
        """Of half the height's and half the width's field angle."""
        longer = math.tan(math.radians(self.angle_deg) / 2)
        height, width = self.radiance.shape[-2:]
        return longer * height / max(height, width), longer * width / max(height, width)


@dataclass(frozen=True)
class PlaneView:
    """One plane as the camera's middle views it.

    Parameters
    ----------
    radiance
        On the pixels of the support, (channels, height, width); 0 where nearer planes hide it.
    distance_um
        Of the plane.
    """

    radiance: Tensor
    distance_um: float


def render_planes(
    twin: Twin, planes: tuple[Plane, ...], bands: int | None = None
) -> tuple[FieldMap, tuple[PlaneView, ...]]:
    """Render planes on the pixels of the reconstruction, nearer ones hiding farther ones.

    What hides what is decided for the camera's middle; the few millimetres of the mask see a
    near edge from a slightly different side, which is left out.

    Parameters
    ----------
    twin
        The camera.
    planes
        In any order.
    bands
        How many channels they have; None for those of the sensor.

    Returns
    -------
    tuple
        The map of the pixels, and the planes from the nearest to the farthest.

    Raises
    ------
    OptionError
        If there is no plane, or one is beyond the model.
    DataError
        If a plane has other channels than the sensor, or holds NaN or negative light.
    """
    if not planes:
        raise OptionError("a scene needs a picture: give at least one")
    for plane in planes:
        _check(twin, plane, bands)
    tangents = [max(plane.tangents[axis] for plane in planes) for axis in (0, 1)]
    field = FieldMap.covering(twin, (tangents[0], tangents[1]))
    at = field.tangents()
    clear = torch.ones(field.support.height, field.support.width)
    views = []
    for plane in sorted(planes, key=lambda each: each.distance_um):
        radiance, opacity = render_plane(plane, at)
        views.append(PlaneView(radiance * (opacity * clear), plane.distance_um))
        clear = clear * (1 - opacity)
    return field, tuple(views)


def _check(twin: Twin, plane: Plane, bands: int | None) -> None:
    channels = bands or len(twin.camera.sensor.channels)
    if plane.radiance.ndim != 3 or plane.radiance.shape[0] != channels:
        whose = "the sensor has" if bands is None else "there are"
        raise DataError(
            f"{whose} {channels} channels, the picture is of shape "
            f"{tuple(plane.radiance.shape)}: (channels, height, width) is needed"
        )
    if not bool(torch.isfinite(plane.radiance).all()) or float(plane.radiance.min()) < 0:
        raise DataError("the picture of the scene holds NaN, infinity or negative light")
    opacity = plane.opacity
    if opacity is not None and not bool(((opacity >= 0) & (opacity <= 1)).all()):
        raise DataError("the picture's opacity must lie between 0 (clear) and 1 (hides all)")
    if not 0 < plane.angle_deg < 180:
        raise OptionError(
            f"a scene that fills {plane.angle_deg:g} deg: an angle above 0deg is needed, "
            "such as 60deg"
        )
    FieldMap.covering(twin, plane.tangents)  # Refuses a scene whose corners are too far out.
    twin.check_source(PointSource(plane.tangents, plane.distance_um))


def render_plane(plane: Plane, at: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Radiance and opacity on pixels at some tangents of the field angle (`FieldMap.tangents`).

    The picture is averaged over about a pixel.
    """
    height, width = plane.radiance.shape[-2:]
    opacity = plane.opacity if plane.opacity is not None else torch.ones(height, width)
    # Colours count as much as they cover, so that what is clear does not bleed into edges.
    layers = torch.cat([plane.radiance * opacity, opacity[None]])[None].float()
    pixels = [
        max(1, round(2 * tangent / float(step)))
        for tangent, step in zip(plane.tangents, _steps(at), strict=True)
    ]
    size = (min(height, pixels[0]), min(width, pixels[1]))
    if size != (height, width):
        layers = nnf.interpolate(layers, size=size, mode="bilinear", antialias=True)
    place = torch.stack([at[1] / plane.tangents[1], at[0] / plane.tangents[0]], dim=-1).float()
    values = nnf.grid_sample(
        layers, place[None], mode="bilinear", padding_mode="border", align_corners=False
    )[0]
    inside = (place.abs() <= 1).all(dim=-1)
    values = values.clamp_min(0) * inside
    opaque = values[-1].clamp(max=1)
    return values[:-1] / opaque.clamp_min(1e-6), opaque


def _steps(at: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor]:
    """Tangent from pixel to pixel in the middle of the field."""
    rows, columns = at[0].shape
    middle = rows // 2, columns // 2
    return (
        at[0][middle[0], middle[1]] - at[0][max(middle[0] - 1, 0), middle[1]],
        at[1][middle[0], middle[1]] - at[1][middle[0], max(middle[1] - 1, 0)],
    )


def in_channels(radiance: Tensor, channels: int) -> Tensor:
    """A linear picture, (3, height, width), or its luminance for a sensor of one channel."""
    if channels != 1:
        return radiance
    return (radiance * torch.tensor(_LUMINANCE)[:, None, None]).sum(dim=0, keepdim=True)
