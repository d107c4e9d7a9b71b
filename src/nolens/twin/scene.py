"""Scenes: pictures at distances, nearer ones before farther ones."""

import math
from dataclasses import dataclass

import torch
import torch.nn.functional as nnf
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.operators import Region
from nolens.optics import PointSource
from nolens.twin.field import FieldMap
from nolens.twin.model import Twin


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
class Seen:
    """What the camera's middle sees of one plane.

    Parameters
    ----------
    radiance
        On the pixels of the support, (channels, height, width); 0 where nearer planes hide it.
    distance_um
        Of the plane.
    """

    radiance: Tensor
    distance_um: float


def arrange(twin: Twin, planes: tuple[Plane, ...]) -> tuple[FieldMap, tuple[Seen, ...]]:
    """Lay planes out on the pixels of the reconstruction, nearer ones hiding farther ones.

    What hides what is decided for the camera's middle; the few millimetres of the mask see a
    near edge from a slightly different side, which is left out.

    Parameters
    ----------
    twin
        The camera.
    planes
        In any order.

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
        _check(twin, plane)
    tangents = [max(plane.tangents[axis] for plane in planes) for axis in (0, 1)]
    field = FieldMap.covering(twin, (tangents[0], tangents[1]))
    at = field.tangents()
    clear = torch.ones(field.region.height, field.region.width)
    seen = []
    for plane in sorted(planes, key=lambda each: each.distance_um):
        radiance, opacity = on_cells(plane, at, field.region)
        seen.append(Seen(radiance * (opacity * clear), plane.distance_um))
        clear = clear * (1 - opacity)
    return field, tuple(seen)


def _check(twin: Twin, plane: Plane) -> None:
    channels = len(twin.camera.sensor.channels)
    if plane.radiance.ndim != 3 or plane.radiance.shape[0] != channels:
        raise DataError(
            f"the sensor has {channels} channels, the picture is of shape "
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


def on_cells(plane: Plane, at: tuple[Tensor, Tensor], region: Region) -> tuple[Tensor, Tensor]:
    """Radiance and opacity on the pixels, the picture averaged over about a pixel.

    Parameters
    ----------
    plane
        The picture.
    at
        Tangents of the field angle of every pixel (`FieldMap.tangents`).
    region
        The pixels.
    """
    height, width = plane.radiance.shape[-2:]
    opacity = plane.opacity if plane.opacity is not None else torch.ones(height, width)
    # Colours count as much as they cover, so that what is clear does not bleed into edges.
    layers = torch.cat([plane.radiance * opacity, opacity[None]])[None].float()
    cells = [
        max(1, round(2 * tangent / float(step)))
        for tangent, step in zip(plane.tangents, _steps(at), strict=True)
    ]
    size = (min(height, cells[0]), min(width, cells[1]))
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
    """Tangent from cell to cell in the middle of the field."""
    rows, columns = at[0].shape
    middle = rows // 2, columns // 2
    return (
        at[0][middle[0], middle[1]] - at[0][max(middle[0] - 1, 0), middle[1]],
        at[1][middle[0], middle[1]] - at[1][middle[0], max(middle[1] - 1, 0)],
    )


_LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Of linear sRGB (IEC 61966-2-1)."""


def in_channels(radiance: Tensor, channels: int) -> Tensor:
    """A linear picture in colour, or its luminance for a sensor of one channel.

    Parameters
    ----------
    radiance
        (3, height, width).
    channels
        Of the sensor.
    """
    if channels != 1:
        return radiance
    return (radiance * torch.tensor(_LUMINANCE)[:, None, None]).sum(dim=0, keepdim=True)
