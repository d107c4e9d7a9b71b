"""Rays of a point source through the layers before and behind the mask."""

import math

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from optical_bench import NOTHING, PAPER, Way

from nolens.optics import Illumination, PointSource, Stack

FILM = Stack((305.0, 490.0), (1.59, 1.52))
BEHIND = Stack((1060.0, 235.0), (1.47, 1.0))
TANGENTS = st.floats(-1.2, 1.2)
PLACES = st.floats(-3000, 3000)
DISTANCES = st.floats(3.5, 8).map(lambda decades: 10.0**decades)


def _angles_deg(p: float, stack: Stack) -> list[float]:
    return [math.degrees(math.asin(p / n)) for n in stack.indices]


@given(TANGENTS, TANGENTS, DISTANCES, PLACES, PLACES, st.sampled_from([NOTHING, FILM]))
def test_chief_ray_obeys_snells_law(row, column, distance_um, at_row, at_column, before):
    """From the source through every layer, by angles, it passes the mask and hits the place."""
    source = PointSource((row, column), distance_um)
    chief = Illumination(source, before, BEHIND).chief_ray((at_row, at_column))
    p = math.hypot(*chief.p)
    assert chief.squared == pytest.approx(p * p, rel=1e-12)

    # The tangents of the angles, layer by layer; the source stands in air.
    def walked(stack: Stack) -> float:
        angles = _angles_deg(p, stack)
        steps = zip(stack.thicknesses_um, angles, strict=True)
        return sum(t * math.tan(math.radians(angle)) for t, angle in steps)

    air = Stack((distance_um,), (1.0,))
    to_mask = walked(air.then(before))
    to_sensor = to_mask + walked(BEHIND)
    unit = [part / p for part in chief.p] if p > 0 else [0.0, 0.0]
    scale = 1e-9 * distance_um + 1e-6
    for axis, (tangent, at) in enumerate(((row, at_row), (column, at_column))):
        start = -tangent * distance_um
        assert start + unit[axis] * to_mask == pytest.approx(chief.mask_um[axis], abs=scale)
        assert start + unit[axis] * to_sensor == pytest.approx(at, abs=scale)


@given(TANGENTS, TANGENTS, PLACES, PLACES)
def test_chief_ray_of_a_plane_wave(row, column, at_row, at_column):
    """It has the source's angle in air, and leaves the mask where Snell's angles say."""
    source = PointSource((row, column))
    chief = Illumination(source, FILM, BEHIND).chief_ray((at_row, at_column))
    angle = math.atan(math.hypot(row, column))
    assert math.degrees(angle) == pytest.approx(source.angle_deg)
    assert source.p == pytest.approx(math.sin(angle), abs=1e-12)
    assert math.hypot(*chief.p) == pytest.approx(math.sin(angle), abs=1e-12)
    angles = _angles_deg(math.sin(angle), BEHIND)
    steps = zip(BEHIND.thicknesses_um, angles, strict=True)
    moved = sum(t * math.tan(math.radians(each)) for t, each in steps)
    tangent = math.hypot(row, column)
    for axis, (part, at) in enumerate(((row, at_row), (column, at_column))):
        unit = part / tangent if tangent > 0 else 0.0
        assert chief.p[axis] == pytest.approx(math.sin(angle) * unit, abs=1e-12)
        assert at - chief.mask_um[axis] == pytest.approx(moved * unit, abs=1e-9)


def test_light_from_the_right_falls_to_the_right():
    """As in the picture, which is upright: a source up and to the right moves the pattern so."""
    for distance_um in (math.inf, 3e5, 1e4):
        source = PointSource((-0.2, 0.5), distance_um)
        chief = Illumination(source, NOTHING, PAPER).chief_ray((0.0, 0.0))
        assert chief.p[0] < 0 < chief.p[1]
        assert chief.mask_um[1] < 0 < chief.mask_um[0]


@pytest.mark.parametrize("before", [NOTHING, FILM], ids=["bare", "film"])
@pytest.mark.parametrize("distance_um", [1e4, 3e5, 1e8])
@pytest.mark.parametrize("angle_deg", [0, 25, 50])
def test_slope_of_the_path_is_the_rays_direction(angle_deg, distance_um, before):
    """The gradient of the optical path is p; the plane wave of the chief ray is taken out."""
    light = Way(angle_deg, 35).light(distance_um, before)
    chief = light.chief_ray((120.0, -340.0))
    rows = (chief.mask_um[0] + torch.linspace(-400, 400, 7, dtype=torch.float64))[:, None]
    columns = chief.mask_um[1] + torch.linspace(-500, 500, 9, dtype=torch.float64)
    p = light.direction(rows, columns)
    step = 0.5
    for axis, (up, right) in enumerate(((step, 0.0), (0.0, step))):
        ahead = light.path_um(rows + up, columns + right, chief)
        behind = light.path_um(rows - up, columns - right, chief)
        slope = (ahead - behind) / (2 * step)
        # A path of 1e8 µm is known to 1e-8 µm.
        torch.testing.assert_close(slope, p[axis] - chief.p[axis], rtol=0, atol=1e-7)


@pytest.mark.parametrize("distance_um", [1e4, 3e5])
def test_path_is_that_of_straight_lines_in_air(distance_um):
    """Without layers it is the distance from the source, less the plane wave."""
    light = Way(40, 20).light(distance_um)
    chief = light.chief_ray((50.0, 80.0))
    start = light.source.origin_um()
    rows = torch.linspace(-900, 700, 5, dtype=torch.float64)[:, None]
    columns = torch.linspace(-600, 800, 6, dtype=torch.float64)

    def distance(row: torch.Tensor, column: torch.Tensor) -> torch.Tensor:
        return ((row - start[0]) ** 2 + (column - start[1]) ** 2 + distance_um**2).sqrt()

    at = [torch.tensor(place, dtype=torch.float64) for place in chief.mask_um]
    carrier = chief.p[0] * (rows - at[0]) + chief.p[1] * (columns - at[1])
    expected = distance(rows, columns) - distance(at[0], at[1]) - carrier
    torch.testing.assert_close(light.path_um(rows, columns, chief), expected, rtol=0, atol=1e-8)


@pytest.mark.parametrize("before", [NOTHING, FILM], ids=["bare", "film"])
def test_direction_at_the_chief_rays_place_is_its_own(before):
    light = Way(35, -60).light(2e4, before)
    chief = light.chief_ray((500.0, 200.0))
    at = [torch.tensor(place, dtype=torch.float64) for place in chief.mask_um]
    got = [float(part) for part in light.direction(at[0], at[1])]
    assert got == pytest.approx(chief.p, rel=1e-9)
    assert float(light.path_um(at[0], at[1], chief)) == pytest.approx(0, abs=1e-8)


def test_plane_wave_has_one_direction_and_no_path():
    light = Way(30, 90).light()
    chief = light.chief_ray((0.0, 0.0))
    rows, columns = torch.zeros(3, 1, dtype=torch.float64), torch.arange(4, dtype=torch.float64)
    p = light.direction(rows, columns)
    torch.testing.assert_close(p[0], torch.full((3, 4), 0.5, dtype=torch.float64))
    assert float(p[1].abs().max()) < 1e-15
    assert float(light.path_um(rows, columns, chief).abs().max()) == 0


def test_ray_below_a_source_goes_straight():
    light = Way(0).light(1e4, FILM)
    chief = light.chief_ray((0.0, 0.0))
    assert chief.p == (0.0, 0.0)
    assert chief.mask_um == (0.0, 0.0)
    at = torch.zeros(1, dtype=torch.float64)
    assert [float(part) for part in light.direction(at, at)] == [0.0, 0.0]
