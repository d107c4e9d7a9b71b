"""Scenes on the cells: upright, in their place, near before far, and what is refused."""

import math
from itertools import permutations

import pytest
import torch
from cameras import cropped, flattened, in_grey, twin_of
from torch import Tensor

from nolens.errors import DataError, OptionError
from nolens.twin import FieldMap, Plane, PlaneView, render_planes

TWIN = twin_of(flattened(cropped(64, 80, pitch="3.1 um")))
CELL_UM = 6.2
FAR_UM = 300e3


def _picture(height: int, width: int, value: float = 0.0) -> Tensor:
    return torch.full((3, height, width), value)


def _one(plane: Plane) -> tuple[FieldMap, PlaneView]:
    field, seen = render_planes(TWIN, (plane,))
    assert len(seen) == 1
    return field, seen[0]


def _middle(field: FieldMap, lit: Tensor) -> tuple[float, float]:
    """Mean tangents of what is lit."""
    rows, columns = field.tangents()
    total = lit.double().sum()
    return float((lit * rows).sum() / total), float((lit * columns).sum() / total)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 7), (2, 6), (5, 0), (5, 7), (3, 4)])
def test_a_bright_pixel_is_seen_in_its_direction(row, column):
    """Upright and not mirrored: a scene of 8 × 6 pixels that fills 40° of its width."""
    picture = _picture(6, 8)
    picture[:, row, column] = 1
    field, seen = _one(Plane(picture, 40.0, FAR_UM))
    side = math.tan(math.radians(20)) / 4  # Tangent of one pixel.
    expected = (row - 2.5) * side, (column - 3.5) * side
    lit = seen.radiance[1] > 0.5
    rows, columns = field.tangents()
    assert _middle(field, lit) == pytest.approx(expected, abs=0.1 * side)
    assert float(rows[lit].min()) == pytest.approx(expected[0] - side / 2, abs=0.1 * side)
    assert float(columns[lit].max()) == pytest.approx(expected[1] + side / 2, abs=0.1 * side)


def test_a_ramp_of_light_is_where_it_belongs_to_a_part_of_a_cell():
    """Brightness that grows with the tangent of the angle, downwards in R and rightwards in G."""
    picture = _picture(30, 40)
    picture[0] = (torch.arange(30.0)[:, None] + 0.5) / 30
    picture[1] = (torch.arange(40.0) + 0.5) / 40
    field, seen = _one(Plane(picture, 40.0, FAR_UM))
    rows, columns = field.tangents()
    y, x = (at / math.tan(math.radians(20)) for at in (rows / 0.75, columns))
    inside = (y.abs() < 1 - 1 / 30) & (x.abs() < 1 - 1 / 40)
    for channel, place in enumerate((y, x)):
        expected = ((1 + place) / 2).float()[inside]
        torch.testing.assert_close(seen.radiance[channel][inside], expected, rtol=0, atol=1e-4)


def test_an_edge_lies_where_it_is_painted():
    """The right quarter of the picture is bright; its pixels are finer than cells."""
    picture = _picture(300, 400)
    picture[:, :, 300:] = 1
    field, seen = _one(Plane(picture, 30.0, FAR_UM))
    columns = field.tangents()[1][field.support.height // 2]
    line = seen.radiance[0][field.support.height // 2]
    edge, cell = math.tan(math.radians(15)) / 2, CELL_UM / 1278
    assert float(line[columns < edge - cell].abs().max()) < 1e-6
    bright = line[(columns > edge + cell) & (columns < 2 * edge)]
    assert len(bright) > 10
    assert float(bright.min()) > 1 - 1e-5


def test_channels_stay_apart():
    picture = torch.tensor([0.2, 0.5, 0.9])[:, None, None].expand(3, 5, 5).contiguous()
    _, seen = _one(Plane(picture, 20.0, FAR_UM))
    for channel, value in enumerate((0.2, 0.5, 0.9)):
        lit = seen.radiance[channel][seen.radiance[channel] > 0]
        assert lit.tolist() == pytest.approx([value] * len(lit), rel=1e-5)


@pytest.mark.parametrize("size", [(3, 3), (40, 60), (900, 700)])
def test_an_even_picture_is_even_inside_and_dark_outside(size):
    field, seen = _one(Plane(_picture(*size, 0.7), 35.0, FAR_UM))
    rows, columns = field.tangents()
    longer = math.tan(math.radians(17.5)) / max(size)
    inside = (rows.abs() < longer * size[0] - 1e-6) & (columns.abs() < longer * size[1] - 1e-6)
    outside = (rows.abs() > longer * size[0] + 1e-6) | (columns.abs() > longer * size[1] + 1e-6)
    torch.testing.assert_close(seen.radiance[:, inside], torch.full_like(
        seen.radiance[:, inside], 0.7
    ), rtol=1e-5, atol=0)  # fmt: skip
    assert float(seen.radiance[:, outside].abs().max()) == 0
    assert int(inside.sum()) > 0.9 * inside.numel()


def test_the_angle_is_that_of_the_longer_side():
    for size in ((300, 400), (400, 300)):
        plane = Plane(_picture(*size), 60.0, FAR_UM)
        longer = math.tan(math.radians(30))
        expected = [longer * each / 400 for each in size]
        assert plane.tangents == pytest.approx(expected)


def test_fine_pictures_are_averaged_not_picked():
    """A checkerboard finer than the cells gives grey, whatever the phase."""
    picture = _picture(600, 600)
    picture[:, ::2, ::2] = 1
    picture[:, 1::2, 1::2] = 1
    field, seen = _one(Plane(picture, 20.0, FAR_UM))
    middle = seen.radiance[:, 10:-10, 10:-10]
    assert field.support.height < 300
    assert float(middle.min()) > 0.4
    assert float(middle.max()) < 0.6


# --- Several planes --------------------------------------------------------------------------


def test_half_clear_planes_dim_what_is_behind():
    """Of three planes each keeps what the nearer ones let through."""
    near = Plane(_picture(4, 4, 1.0), 20.0, 80e3, torch.full((4, 4), 0.5))
    middle = Plane(_picture(4, 4, 1.0), 20.0, 100e3, torch.full((4, 4), 0.25))
    far = Plane(_picture(4, 4, 1.0), 20.0, math.inf)
    _, seen = render_planes(TWIN, (far, near, middle))
    assert [each.distance_um for each in seen] == [80e3, 100e3, math.inf]
    inner = [each.radiance[:, 20:-20, 20:-20] for each in seen]
    for part, expected in zip(inner, (0.5, 0.5 * 0.25, 0.5 * 0.75), strict=True):
        torch.testing.assert_close(part, torch.full_like(part, expected), rtol=1e-5, atol=0)


def test_near_hides_far_in_any_order():
    """A near plane of half the size in front of a far one."""
    near = Plane(_picture(4, 4, 0.3), 15.0, 50e3)
    far = Plane(_picture(4, 4, 0.9), 30.0, 200e3)
    for order in permutations((near, far)):
        field, seen = render_planes(TWIN, order)
        rows, columns = field.tangents()
        side = math.tan(math.radians(7.5))
        covered = (rows.abs() < side - 1e-6) & (columns.abs() < side - 1e-6)
        free = (rows.abs() > side + 1e-6) | (columns.abs() > side + 1e-6)
        inside = (rows.abs() < 2 * side) & (columns.abs() < 2 * side)
        front, back = (each.radiance[1] for each in seen)
        assert [each.distance_um for each in seen] == [50e3, 200e3]
        assert float(back[covered].abs().max()) < 1e-6
        assert front[covered].tolist() == pytest.approx([0.3] * int(covered.sum()), rel=1e-5)
        assert float(front[free].abs().max()) == 0
        assert float(back[free & inside].min()) == pytest.approx(0.9, rel=1e-5)


def test_what_is_clear_does_not_bleed_into_edges():
    """Green paint under full transparency beside red: red stays red up to the edge."""
    picture, opacity = _picture(6, 6), torch.zeros(6, 6)
    picture[0, :, :3] = 0.8
    picture[1, :, 3:] = 0.8
    opacity[:, :3] = 1
    _, seen = _one(Plane(picture, 20.0, FAR_UM, opacity))
    assert float(seen.radiance[1].max()) < 1e-6
    assert float(seen.radiance[0].max()) == pytest.approx(0.8, rel=1e-5)
    covered = seen.radiance[0] > 0
    assert bool(((seen.radiance[0] > 0.1) & (seen.radiance[0] < 0.7)).any())  # The edge is soft.
    assert 0.5 < float(covered.double().mean()) < 0.7


def test_the_map_holds_the_widest_plane():
    wide = Plane(_picture(1, 10, 1.0), 40.0, FAR_UM)
    tall = Plane(_picture(10, 1, 1.0), 30.0, FAR_UM)
    field, _ = render_planes(TWIN, (wide, tall))
    tangents = math.tan(math.radians(15)), math.tan(math.radians(20))
    assert field == FieldMap.covering(TWIN, tangents)


# --- What is refused -------------------------------------------------------------------------


def _refused(planes: tuple[Plane, ...], error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        render_planes(TWIN, planes)


def test_no_plane():
    _refused((), OptionError, "at least one")


@pytest.mark.parametrize("shape", [(1, 4, 4), (4, 4, 4), (4, 4), (1, 3, 4, 4)])
def test_wrong_channels(shape):
    _refused((Plane(torch.ones(shape), 20.0, FAR_UM),), DataError, "3 channels")


def test_a_grey_sensor_takes_one_channel():
    grey = twin_of(in_grey(flattened(cropped(64, 64))))
    _, seen = render_planes(grey, (Plane(torch.ones(1, 4, 4), 20.0, FAR_UM),))
    assert seen[0].radiance.shape[0] == 1
    with pytest.raises(DataError, match="1 channels"):
        render_planes(grey, (Plane(torch.ones(3, 4, 4), 20.0, FAR_UM),))


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e-3])
def test_no_light(value):
    picture = _picture(4, 4, 0.5)
    picture[1, 2, 3] = value
    _refused((Plane(picture, 20.0, FAR_UM),), DataError, "NaN, infinity or negative")


@pytest.mark.parametrize("value", [math.nan, -1e-3, 1.001])
def test_no_opacity(value):
    opacity = torch.ones(4, 4)
    opacity[1, 2] = value
    _refused((Plane(_picture(4, 4), 20.0, FAR_UM, opacity),), DataError, "between 0")


def test_no_distance():
    _refused((Plane(_picture(4, 4), 20.0, math.nan),), OptionError, "1 mm or more")


@pytest.mark.parametrize("angle_deg", [0.0, -10.0, 180.0, 200.0, math.nan])
def test_no_angle(angle_deg):
    _refused((Plane(_picture(4, 4), angle_deg, FAR_UM),), OptionError, "an angle above 0deg")


def test_beyond_the_model():
    _refused((Plane(_picture(4, 4), 101.0, FAR_UM),), OptionError, "choose an angle of at most")


@pytest.mark.parametrize("distance_um", [0.99e3, 0.0, -1e5])
def test_too_near(distance_um):
    far = Plane(_picture(4, 4), 20.0, FAR_UM)
    near = Plane(_picture(4, 4), 20.0, distance_um)
    _refused((far, near), OptionError, "choose 1 mm or more")
    render_planes(TWIN, (far, Plane(_picture(4, 4), 20.0, 1e3)))
