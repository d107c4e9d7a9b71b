"""A grid of dots in a picture: each one found near where Snell's law puts it, and judged."""

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.evaluate import Dot, Spot, angles_of, brightest_places, grade, spots_at
from nolens.jobs.measuring.field_pose import Pose
from nolens.jobs.measuring.field_rays import Places, Rays, between_deg
from nolens.optics import PointSource
from nolens.twin import LARGEST_ANGLE_DEG, Twin

_MIDDLE_DEG = 12.0
_NEXT = 9
_FEWEST = 5
_NEARLY = 1.005
_MOST_DOTS = 20_000


@dataclass(frozen=True)
class DotGrid:
    """A grid of dots in a picture.

    Parameters
    ----------
    dots
        All that should be there, by angle.
    good_deg, distorted_deg, lost_deg
        See `nolens.evaluate.Angles`.
    pose
        How the grid was found to stand.
    cell_deg
        What a cell in the middle of the picture sees.
    picture
        (rows, columns).
    """

    dots: list[Dot]
    good_deg: float | None
    distorted_deg: float | None
    lost_deg: float | None
    pose: Pose
    cell_deg: float
    picture: Tensor


def found_grid(
    picture: Tensor,
    twin: Twin,
    *,
    pitch_um: float,
    distance_um: float,
    reach_deg: float = LARGEST_ANGLE_DEG,
) -> DotGrid:
    """Find the dots of a grid in a picture, and judge each.

    Where it should be follows from the camera's layers by Snell's law, once it is known how the
    grid stands before the camera (`Pose`, from the dots in the middle).

    Parameters
    ----------
    picture
        (rows, columns), linear, around the cell on the camera's axis.
    twin
        The camera.
    pitch_um, distance_um
        Of the grid; the distance from the camera.
    reach_deg
        Half angle up to which dots are looked for.

    Raises
    ------
    DataError
        If there are no dots in the middle of the picture, or they are not so far apart.
    OptionError
        If dots so far apart are less than two cells apart in the picture, or beyond number.
    """
    step = pitch_um / distance_um
    cell_tangent = twin.cell_um / twin.stack().reduced_um
    if step < 2 * cell_tangent:
        raise OptionError(
            f"dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm are "
            f"{step / cell_tangent:.2g} cells apart in the picture: to be told apart they need 2 "
            f"or more, {2 * cell_tangent * distance_um * 1e-3:.2g} mm"
        )
    at = grid_tangents(pitch_um, distance_um, reach_deg)
    rays = Rays.of(twin, (picture.shape[0], picture.shape[1]))
    pose = Pose.of(rays.tangents(_middle_tops(picture, rays, step)), pitch_um, distance_um)
    # Up to the last ring, though the pose is not exact.
    limit = math.tan(math.radians(reach_deg)) * _NEARLY
    tangents = [each for each in map(pose.tangent, at) if math.hypot(*each) <= limit]
    tangents.sort(key=lambda each: math.hypot(*each))
    inside = [_inside(place, picture) for place in rays.cells(tangents)]
    tangents = [each for each, kept in zip(tangents, inside, strict=True) if kept]
    spots = spots_at(picture, rays.cells(tangents), rays.spacings(tangents, step))
    dots = _judged(rays, tangents, spots)
    ends = angles_of(dots)
    return DotGrid(
        dots, ends.good_deg, ends.distorted_deg, ends.lost_deg, pose,
        math.degrees(math.atan(cell_tangent)), picture,
    )  # fmt: skip


def grid_tangents(
    pitch_um: float, distance_um: float, reach_deg: float
) -> list[tuple[float, float]]:
    """Tangents, (row, column), of all dots of a grid around the axis up to a half angle.

    Raises
    ------
    OptionError
        If there are fewer than nine, or more than 20 000.
    """
    step, limit = pitch_um / distance_um, math.tan(math.radians(reach_deg))
    most = int(limit / step + 1e-9)
    if (2 * most + 1) ** 2 > _MOST_DOTS:
        raise OptionError(
            f"dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm are more than "
            f"{_MOST_DOTS} up to {reach_deg:g} deg: choose a larger pitch or a smaller reach"
        )
    if most < 1:
        raise OptionError(
            f"of dots {pitch_um * 1e-3:g} mm apart at {distance_um * 1e-3:g} mm, up to "
            f"{reach_deg:g} deg there is only one: choose a smaller pitch or a larger reach"
        )
    return [
        (i * step, j * step)
        for i in range(-most, most + 1)
        for j in range(-most, most + 1)
        if math.hypot(i, j) * step <= limit * (1 + 1e-9)
    ]


def _judged(rays: Rays, tangents: Places, spots: list[Spot | None]) -> list[Dot]:
    """Every dot beside those in the middle: within 12°, or the nine next to the axis."""
    angles = [PointSource(each).angle_deg for each in tangents]
    expected = rays.light(tangents)
    middle = [
        (spot, light)
        for number, (spot, light) in enumerate(zip(spots, expected, strict=True))
        if spot is not None and (angles[number] <= _MIDDLE_DEG or number < _NEXT)
    ]
    if len(middle) < _FEWEST:
        raise DataError(
            f"only {len(middle)} dots of the grid are found in the middle of the picture: check "
            "--dot-pitch, --distance and --camera, and that the picture is of a grid of dots"
        )
    width = _median([spot.width for spot, _ in middle])
    power = _median([spot.light / light for spot, light in middle])
    places = rays.cells(tangents)
    there = rays.tangents(
        [place if spot is None else spot.place for place, spot in zip(places, spots, strict=True)]
    )
    dots = []
    for number, (place, spot) in enumerate(zip(places, spots, strict=True)):
        angle, light = angles[number], expected[number]
        if spot is None:
            dots.append(Dot(angle, place, None, None, None, None, None, None, light, "lost"))
            continue
        off = math.dist(spot.place, place)
        share = spot.light / power
        dots.append(
            Dot(
                angle_deg=angle,
                expected=place,
                found=spot.place,
                error_cells=off,
                error_deg=between_deg(tangents[number], there[number]),
                width_cells=spot.width,
                width=spot.width / width,
                light=share,
                expected_light=light,
                grade=grade(
                    width=spot.width / width,
                    error=off / width,
                    light=share / light if light > 0 else 0.0,
                ),
            )
        )
    return dots


def _inside(place: tuple[float, float], picture: Tensor) -> bool:
    return all(0 <= at <= count - 1 for at, count in zip(place, picture.shape, strict=True))


def _middle_tops(picture: Tensor, rays: Rays, step: float) -> Places:
    """Bright places within a few pitches of the axis, or within 12° where that is more."""
    tangent = max(math.tan(math.radians(_MIDDLE_DEG)), 2.6 * step)
    (_, column), *_ = rays.cells([(0.0, tangent)])
    reach = math.ceil(column) - rays.axis[1]
    top, left = (max(0, at - reach) for at in rays.axis)
    part = picture[top : rays.axis[0] + reach + 1, left : rays.axis[1] + reach + 1]
    if part.numel() == 0 or not float(part.max()) > float(part.median()):
        raise DataError("the middle of the picture is empty: it shows no grid of dots")
    return [(top + row, left + column) for row, column in brightest_places(part)]


def _median(values: list[float]) -> float:
    return float(torch.tensor(values, dtype=torch.float64).median())
