"""Real rays, by Snell's law alone, through a sphere and planes: the oracle of ray matrices."""

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Path:
    """A ray in the meridional plane, as it leaves the sphere: where it is, and n sin of its angle.

    Places along the axis count from the sphere's vertex.
    """

    along: float
    aside: float
    p: float


def behind_sphere(
    thicknesses: tuple[float, ...],
    indices: tuple[float, ...],
    surface: int,
    signed_radius: float,
    height: float,
    source: float = math.inf,
) -> Path:
    """Follow a ray that aims at a height over the vertex, from the source through the sphere."""
    before = sum(thicknesses[:surface])
    entered = indices[surface - 1] if surface else 1.0
    p = 0.0
    aside = height
    if math.isfinite(source):
        reduced = source + sum(
            t / n for t, n in zip(thicknesses[:surface], indices[:surface], strict=True)
        )
        p = height / reduced
        aside = source * p / math.sqrt(1 - p * p)
        for t, n in zip(thicknesses[:surface], indices[:surface], strict=True):
            aside += t * p / math.sqrt(n * n - p * p)
    assert before >= 0
    sine = p / entered
    direction = (math.sqrt(1 - sine * sine), sine)
    # Where (s·cos, aside + s·sin) meets the sphere around (signed_radius, 0), next to its vertex.
    half = -signed_radius * direction[0] + aside * direction[1]
    rest = aside * aside
    root = math.sqrt(half * half - rest)
    way = rest / (-half + math.copysign(root, -half)) if rest else 0.0
    place = (way * direction[0], aside + way * direction[1])
    normal = ((place[0] - signed_radius) / -signed_radius, place[1] / -signed_radius)
    # The normal points along the light where it meets the axis.
    ratio = entered / indices[surface]
    incidence = direction[0] * normal[0] + direction[1] * normal[1]
    refracted = math.sqrt(1 - ratio * ratio * (1 - incidence * incidence))
    turned = ratio * direction[1] + (refracted - ratio * incidence) * normal[1]
    return Path(place[0], place[1], indices[surface] * turned)


def crossing_thickness(
    thicknesses: tuple[float, ...],
    indices: tuple[float, ...],
    surface: int,
    layer: int,
    path: Path,
) -> float:
    """Thickness of one layer behind the sphere with which the ray meets the axis on the sensor."""

    def tangent(index: float) -> float:
        return path.p / math.sqrt(index * index - path.p * path.p)

    aside = path.aside - path.along * tangent(indices[surface])
    for number in range(surface, len(indices)):
        if number != layer:
            aside += thicknesses[number] * tangent(indices[number])
    return -aside / tangent(indices[layer])
