"""The wave that a point source throws on the mask."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.optics.layers import Stack


@dataclass(frozen=True)
class PointSource:
    r"""A small disc of light, parallel to the sensor.

    Parameters
    ----------
    tangent
        Tangents of the field angle, (row, column), in the picture's sense: a source to the
        right of the axis has a positive second one, and its PSF lies to the right too.
    distance_um
        From the camera's outermost surface, along the axis; infinity for a plane wave.
    diameter_um
        Of the disc.
    """

    tangent: tuple[float, float] = (0.0, 0.0)
    distance_um: float = math.inf
    diameter_um: float = 0.0

    @property
    def angle_deg(self) -> float:
        """Between the axis and the ray to the middle of the camera."""
        return math.degrees(math.atan(math.hypot(*self.tangent)))

    @property
    def p(self) -> float:
        """Sine of that angle."""
        tangent = math.hypot(*self.tangent)
        return tangent / math.sqrt(1 + tangent * tangent)

    def within(self, angle_deg: float) -> "PointSource":
        """The same source, or the nearest one whose field angle is not larger."""
        if self.angle_deg <= angle_deg:
            return self
        scale = math.tan(math.radians(angle_deg)) / math.hypot(*self.tangent)
        tangent = self.tangent[0] * scale, self.tangent[1] * scale
        return PointSource(tangent, self.distance_um, self.diameter_um)

    def origin_um(self) -> tuple[float, float]:
        """Where the source stands beside the axis, in the frame of the sensor's rows.

        That frame is the picture's, in which the scene is upright: it is turned by 180° against
        the scene, so a source to the right stands at negative columns.
        """
        return -self.tangent[0] * self.distance_um, -self.tangent[1] * self.distance_um


@dataclass(frozen=True)
class ChiefRay:
    """The ray from the source to one place on the sensor, had the mask no relief.

    Parameters
    ----------
    p
        (row, column) direction of n sin θ.
    mask_um
        Where it passes the mask.
    """

    p: tuple[float, float]
    mask_um: tuple[float, float]

    @property
    def squared(self) -> float:
        """p² of its length."""
        return self.p[0] ** 2 + self.p[1] ** 2


@dataclass(frozen=True)
class Illumination:
    """Light of a point source on the mask, by the optical path of exact rays.

    Parameters
    ----------
    source
        Where the light comes from.
    before
        Layers between the source's medium and the mask; none if the mask is the outermost surface.
    after
        Layers between mask and sensor.
    outside
        Refractive index of the medium that the source is in.
    """

    source: PointSource
    before: Stack
    after: Stack
    outside: float = 1.0

    @property
    def p(self) -> float:
        """N sin θ of the source's field angle."""
        return self.outside * self.source.p

    def chief_ray(self, sensor_um: tuple[float, float]) -> ChiefRay:
        """The ray to a place on the sensor, (row, column) direction from its middle."""
        if math.isinf(self.source.distance_um):
            unit = _unit(self.source.tangent)
            p = self.p
            back = -float(self.after.displacement_um(torch.tensor(p, dtype=torch.float64)))
            start = sensor_um
        else:
            start = self.source.origin_um()
            across = (sensor_um[0] - start[0], sensor_um[1] - start[1])
            unit = _unit(across)
            displacement = torch.tensor(math.hypot(*across), dtype=torch.float64)
            ray = self._to_mask().then(self.after).ray(displacement)
            p = float(ray)
            back = float(self._to_mask().displacement_um(ray))
        mask = (start[0] + unit[0] * back, start[1] + unit[1] * back)
        return ChiefRay((unit[0] * p, unit[1] * p), mask)

    def magnification(self, ray: ChiefRay) -> float:
        """How much larger the mask's shadow is than the mask, around a ray; 1 far away."""
        if math.isinf(self.source.distance_um):
            return 1.0
        p = torch.tensor(ray.squared, dtype=torch.float64).sqrt()
        return 1 + float(self.after.spread_um(p) / self._to_mask().spread_um(p))

    def direction(self, rows_um: Tensor, columns_um: Tensor) -> tuple[Tensor, Tensor]:
        """The light's p at places on the mask, float64: (row part, column part)."""
        if math.isinf(self.source.distance_um):
            squared = self.source.tangent[0] ** 2 + self.source.tangent[1] ** 2
            scale = self.outside / math.sqrt(1 + squared)
            one = torch.ones_like(rows_um + columns_um)
            return one * (self.source.tangent[0] * scale), one * (self.source.tangent[1] * scale)
        start = self.source.origin_um()
        across = rows_um - start[0], columns_um - start[1]
        distance = torch.hypot(across[0] + 0 * across[1], across[1] + 0 * across[0])
        p_per_um = self._to_mask().ray(distance) / distance.clamp_min(1e-12)
        return across[0] * p_per_um, across[1] * p_per_um

    def irradiance(self, rows_um: Tensor, columns_um: Tensor) -> Tensor:
        r"""Light on the mask's plane from a source of the same power in all directions; float64.

        1 straight ahead of a source far away. A cone of rays has the power :math:`\sin θ\,dθ` and
        meets a ring of radius r: :math:`z^2 p\,/\,(n^2\cos θ\,r\,dr/dp)`, in one medium cos³θ.
        """
        p = self.direction(rows_um, columns_um)
        squared = p[0].square() + p[1].square()
        cosine = (1 - squared / self.outside**2).sqrt()
        distance = self.source.distance_um
        if math.isinf(distance):
            return cosine.pow(3)
        stack = self._to_mask()
        start = self.source.origin_um()
        radius = (rows_um - start[0]).square() + (columns_um - start[1]).square()
        radius = radius.sqrt()
        p_per_um = torch.where(
            radius > 1e-9, squared.sqrt() / radius.clamp_min(1e-9), 1 / stack.reduced_um
        )
        spread = stack.spread_um(squared.sqrt())
        return (distance / self.outside) ** 2 * p_per_um / (cosine * spread)

    def path_um(self, rows_um: Tensor, columns_um: Tensor, chief: ChiefRay) -> Tensor:
        r"""Optical path from the source, less the plane wave of the chief ray; float64.

        With p constant along a ray the path is :math:`p·r + Σ t\sqrt{n^2 - p^2}`.
        """
        if math.isinf(self.source.distance_um):
            return torch.zeros_like(rows_um + columns_um)
        start = self.source.origin_um()
        p = self.direction(rows_um, columns_um)
        stack = self._to_mask()
        lateral = p[0] * (rows_um - start[0]) + p[1] * (columns_um - start[1])
        path = lateral + stack.axial_um(p[0] ** 2 + p[1] ** 2)
        at = chief.mask_um
        central = chief.p[0] * (at[0] - start[0]) + chief.p[1] * (at[1] - start[1])
        squared = torch.tensor(chief.squared, dtype=torch.float64)
        carrier = chief.p[0] * (rows_um - at[0]) + chief.p[1] * (columns_um - at[1])
        return path - central - stack.axial_um(squared) - carrier

    def _to_mask(self) -> Stack:
        return Stack((self.source.distance_um,), (self.outside,)).then(self.before)


def _unit(vector: tuple[float, float]) -> tuple[float, float]:
    length = math.hypot(*vector)
    return (vector[0] / length, vector[1] / length) if length > 0 else (0.0, 0.0)
