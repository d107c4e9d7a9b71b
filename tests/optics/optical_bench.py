"""What the tests of the optics share: the paper's layers, formulas of rays, and measures."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.optics import Grid, Illumination, Media, PointSource, Relief, Stack

WAVELENGTH_UM = 0.55
RESIN, GLASS, AIR = 1.47, 1.52, 1.0
PAPER = Stack((1060.0, 490.0, 235.0), (RESIN, GLASS, AIR))
NOTHING = Stack((), ())
MEDIA = Media(WAVELENGTH_UM, AIR, RESIN)

Pair = tuple[float, float]


def relative_error(got: Tensor, expected: Tensor) -> float:
    """Norm of the difference over the norm of what was expected."""
    wide = torch.complex128 if expected.is_complex() else torch.float64
    got, expected = got.to(wide), expected.to(wide)
    return float((got - expected).norm() / expected.norm())


def snell_um(stack: Stack, angle_deg: float) -> float:
    """How far a ray that comes from air moves sideways: tangents of the angles in the layers."""
    sine = math.sin(math.radians(angle_deg))
    layers = zip(stack.thicknesses_um, stack.indices, strict=True)
    return sum(t * math.tan(math.asin(sine / n)) for t, n in layers)


@dataclass(frozen=True)
class Way:
    """Direction of a source: angle to the axis, and azimuth from the columns to the rows."""

    angle_deg: float
    azimuth_deg: float = 0.0

    def __str__(self) -> str:
        return f"{self.angle_deg:g} deg at {self.azimuth_deg:g}"

    @property
    def p(self) -> float:
        """Sine of the angle."""
        return math.sin(math.radians(self.angle_deg))

    def along(self, length: float) -> Pair:
        """(row, column) parts of a vector that points where the light goes."""
        azimuth = math.radians(self.azimuth_deg)
        return length * math.sin(azimuth), length * math.cos(azimuth)

    def light(
        self, distance_um: float = math.inf, before: Stack = NOTHING, after: Stack = PAPER
    ) -> Illumination:
        tangent = self.along(math.tan(math.radians(self.angle_deg)))
        return Illumination(PointSource(tangent, distance_um), before, after)


def places_um(samples: int, pitch_um: float) -> Tensor:
    """Where samples lie of which the one at samples // 2 is in the middle, float64."""
    return (torch.arange(samples, dtype=torch.float64) - samples // 2) * pitch_um


def caps(
    samples: int, pitch_um: float, radius_um: float, width_um: float, centres: list[Pair]
) -> Relief:
    """Parabolic lenslets that stand on a level surface."""
    place = Grid(samples, samples, pitch_um).positions_um(0)
    height = torch.zeros(samples, samples, dtype=torch.float64)
    for row, column in centres:
        squared = (place[:, None] - row).square() + (place - column).square()
        height += ((width_um / 2) ** 2 - squared).clamp_min(0) / (2 * radius_um)
    return Relief(height.float(), pitch_um)


def centroid_um(pattern: Tensor, grid: Grid, near: Pair, within_um: float) -> Pair:
    """Middle of the light of a spot, of what is brighter than 0.3 of its peak."""
    rows, columns = grid.positions_um(0)[:, None], grid.positions_um(1)
    inside = torch.hypot(rows - near[0], columns - near[1]) < within_um
    weight = pattern.double() * inside
    weight = (weight - 0.3 * weight.max()).clamp_min(0)
    total = weight.sum()
    return float((weight * rows).sum() / total), float((weight * columns).sum() / total)
