"""Cells as directions: chief rays, solid angles, and how far the model reaches."""

import math
import re

import pytest
import torch
from cameras import GREEN, cropped, flattened, in_grey, reduced_um, snell_um, twin_of
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import dblquad

from nolens.errors import OptionError
from nolens.operators import PixelRectangle
from nolens.optics import PointSource
from nolens.twin import FieldMap, Plane, Twin, acceptance_support, irradiate, render_planes

# Pixels of 12.4 um: an eighth of the cells along each side.
EVEN = twin_of(flattened(cropped(32, 40, pitch="12.4 um")))
ODD = twin_of(flattened(cropped(34, 38, pitch="12.4 um")))
"""17 × 19 cells: the middle one lies on the axis."""
GREY = twin_of(in_grey(flattened(cropped(33, 40, pitch="12.4 um"))))
WET = twin_of(EVEN.camera.model_copy(update={"outside": 1.33}))
"""In water, where angles are those before the camera."""
TWINS = pytest.mark.parametrize("twin", [EVEN, ODD, GREY], ids=["even", "odd", "grey"])
TWINS_ANYWHERE = pytest.mark.parametrize("twin", [ODD, GREY, WET], ids=["odd", "grey", "wet"])


@TWINS
def test_the_middle_cell_is_on_the_axis(twin):
    field = FieldMap.covering(twin, (0.2, 0.3))
    support, cells = field.support, twin.shape
    middle = cells[0] // 2 - support.top, cells[1] // 2 - support.left
    assert field.source(*middle, math.inf).tangent == (0.0, 0.0)
    rows, columns = field.tangents()
    assert float(rows[middle]) == 0
    assert float(columns[middle]) == 0


@TWINS
def test_the_region_is_centred_and_even(twin):
    for tangents in ((0.2, 0.3), (0.01, 0.5), (0.4, 0.001), (0.0001, 0.0001)):
        support = FieldMap.covering(twin, tangents).support
        assert support.height % 2 == support.width % 2 == 0
        assert support == PixelRectangle.centred(support.height, support.width, twin.shape)
        # As many cells on both sides of the cell on the axis, but for the first.
        assert twin.shape[0] // 2 - support.top == support.height // 2
        assert twin.shape[1] // 2 - support.left == support.width // 2


@TWINS
@settings(max_examples=25)
@given(st.floats(0.01, 0.7), st.floats(0.01, 0.7))
def test_the_region_ends_where_the_scene_ends(twin, down, right):
    """The scene's edge lies within the first cell, counted from the cell's chief ray."""
    field = FieldMap.covering(twin, (down, right))
    rows, columns = field.tangents()
    middle = field.support.height // 2, field.support.width // 2
    first = -float(rows[0, middle[1]]), -float(columns[middle[0], 0])
    second = -float(rows[1, middle[1]]), -float(columns[middle[0], 1])
    for tangent, outer, inner in zip((down, right), first, second, strict=True):
        assert inner <= tangent * (1 + 1e-9)
        assert outer >= tangent * (1 - 1e-9)


@pytest.mark.parametrize("angle_deg", [5.0, 20.0, 35.0])
def test_cells_are_counted_by_snells_law(angle_deg):
    tangent = math.tan(math.radians(angle_deg))
    field = FieldMap.covering(EVEN, (tangent / 2, tangent))
    reach = snell_um(EVEN.camera, angle_deg) / (2 * 12.4)
    assert field.support.width == 2 * math.ceil(reach)


@TWINS_ANYWHERE
@settings(max_examples=25)
@given(st.floats(0, 1), st.floats(0, 1), st.sampled_from([1e4, 3e5, math.inf]))
def test_the_chief_ray_of_a_cell_lands_on_it(twin, down, right, distance_um):
    field = FieldMap.covering(twin, (0.5, 0.7))
    row = round(down * (field.support.height - 1))
    column = round(right * (field.support.width - 1))
    source = field.source(row, column, distance_um)
    assert source.distance_um == distance_um
    landed = twin.shift_um(source)
    wanted = [
        (start + at - cells // 2) * twin.pixel_um
        for start, at, cells in zip(
            (field.support.top, field.support.left), (row, column), twin.shape, strict=True
        )
    ]
    assert landed == pytest.approx(wanted, abs=1e-6)
    rows, columns = field.tangents()
    tangent = float(rows[row, column]), float(columns[row, column])
    assert source.tangent == pytest.approx(tangent, rel=1e-9, abs=1e-12)


def test_directions_are_those_of_the_picture():
    """Rows grow downwards and columns to the right; a source up there shines on cells up there."""
    field = FieldMap.covering(EVEN, (0.3, 0.4))
    rows, columns = field.tangents()
    assert (rows.diff(dim=0) > 0).all()
    assert (columns.diff(dim=1) > 0).all()
    source = field.source(0, field.support.width - 1, math.inf)
    assert source.tangent[0] < 0 < source.tangent[1]


@TWINS
@pytest.mark.parametrize("tangents", [(0.1, 0.1), (0.6, 0.6), (0.3, 0.7)])
def test_solid_angles_add_up_to_the_integral(twin, tangents):
    """∫∫ cos θ dA/z² = ∫∫ dx dy / √(1 + x² + y²), over tangents x and y."""
    field = FieldMap.covering(twin, tangents)
    rows, columns = field.tangents()
    # The cells at the edges count as far as they lie in the scene, by their distance to it.
    inside = torch.ones_like(rows)
    for tangent, at, axis in ((tangents[0], rows, 0), (tangents[1], columns, 1)):
        step = torch.gradient(at, dim=axis)[0]
        inside *= (0.5 + (tangent - at.abs()) / step).clamp(0, 1)
    total = float((field.solid_angle() * inside).sum())
    expected, _ = dblquad(
        lambda x, y: 1 / math.sqrt(1 + x * x + y * y),
        -tangents[0], tangents[0], -tangents[1], tangents[1],
    )  # fmt: skip
    # The last row of the map is one cell short of the other side's edge.
    assert total == pytest.approx(expected, rel=0.01)


@TWINS_ANYWHERE
def test_solid_angle_of_a_cell_is_that_of_its_neighbours_directions(twin):
    """cos θ times the area that tangents of the cells around it span."""
    field = FieldMap.covering(twin, (0.5, 0.6))
    rows, columns = field.tangents()
    down, right = torch.gradient(rows), torch.gradient(columns)
    area = down[0] * right[1] - down[1] * right[0]
    expected = area / (1 + rows.square() + columns.square()).sqrt()
    inner = (slice(1, -1), slice(1, -1))
    torch.testing.assert_close(field.solid_angle()[inner], expected[inner], rtol=2e-3, atol=0)
    straight = field.solid_angle()[field.support.height // 2, field.support.width // 2]
    expected = (twin.pixel_um / (twin.camera.outside * reduced_um(twin.camera))) ** 2
    assert float(straight) == pytest.approx(expected, rel=1e-6)


def test_vignetting_by_hand():
    """cos³ of the angle, times the acceptance that the camera's table gives."""
    field = FieldMap.covering(EVEN, (0.3, 0.8))
    rows, columns = field.tangents()
    got = field.vignetting()
    for row, column in ((0, 0), (3, 40), (field.support.height - 1, 5)):
        tangent = math.hypot(float(rows[row, column]), float(columns[row, column]))
        angle = math.degrees(math.atan(tangent))
        assert 10 < angle < 50
        table = dict(zip((0, 10, 20, 30, 40, 50), (1, 0.97, 0.89, 0.76, 0.56, 0.32), strict=True))
        low = 10 * int(angle // 10)
        accepted = table[low] + (table[low + 10] - table[low]) * (angle - low) / 10
        expected = accepted / (1 + tangent**2) ** 1.5
        assert float(got[row, column]) == pytest.approx(expected, rel=1e-9)
    assert float(got[field.support.height // 2, field.support.width // 2]) == pytest.approx(1)


def test_acceptance_by_hand():
    """To the angle that a hundredth of the light comes from, 5° of a PSF, and what is near."""
    twin = EVEN.accepting_all()
    angle_deg = math.degrees(math.acos(0.01 ** (1 / 3)))
    # Angles are tried in steps of a tenth of a degree.
    far_um = snell_um(twin.camera, math.floor(10 * angle_deg) / 10) + snell_um(twin.camera, 5)
    assert acceptance_support(twin, math.inf) == PixelRectangle.centred(
        2 * math.ceil(far_um / twin.pixel_um), 2 * math.ceil(far_um / twin.pixel_um), twin.shape
    )
    near = acceptance_support(twin, 2e3)
    for side, pixels in zip((near.height, near.width), twin.shape, strict=True):
        beside_um = reduced_um(twin.camera) / 2e3 * pixels / 2 * twin.pixel_um
        assert side == 2 * math.ceil((far_um + beside_um) / twin.pixel_um)
    # Pixels of the preset see less from the side; the first angle with less than a hundredth.
    steps = torch.arange(900) / 10
    seen = EVEN.vignetting(torch.sin(torch.deg2rad(steps.double()))) >= 0.01
    last = float(steps[seen][-1])
    assert 60 < last < angle_deg - 10
    far_um = snell_um(EVEN.camera, last) + snell_um(EVEN.camera, 5)
    assert acceptance_support(EVEN, math.inf).height == 2 * math.ceil(far_um / EVEN.pixel_um)


# --- The model's limit -----------------------------------------------------------------------

SHAPES = [(3, 4), (4, 3), (1, 1), (9, 16), (1, 10), (1, 1000)]


def _plane(shape: tuple[int, int], angle_deg: float) -> Plane:
    return Plane(torch.ones(3, *shape), angle_deg, 300e3)


def _named_deg(twin: Twin, shape: tuple[int, int], angle_deg: float) -> float:
    with pytest.raises(OptionError, match="choose an angle of at most") as caught:
        render_planes(twin, (_plane(shape, angle_deg),))
    found = re.search(r"at most ([0-9.]+)deg", str(caught.value))
    assert found is not None
    return float(found[1])


@pytest.mark.parametrize("shape", SHAPES)
def test_corners_beyond_50_deg_are_refused_with_an_angle_that_is_accepted(shape):
    named = _named_deg(EVEN, shape, 101.0)
    assert 60 < named <= 100
    assert all(_named_deg(EVEN, shape, asked_deg) == named for asked_deg in (130.0, 179.0))
    field, seen = render_planes(EVEN, (_plane(shape, named),))
    assert float(seen[0].radiance.max()) == pytest.approx(1)
    # Field points at the support's corners lie farther out than the scene.
    light = irradiate(EVEN, field, seen, field_points=3, light=GREEN).light
    assert bool(light.isfinite().all())
    assert float(light.min()) > 0
    # It is nearly the largest.
    with pytest.raises(OptionError, match="deg"):
        render_planes(EVEN, (_plane(shape, named + 0.5),))


def test_the_limit_is_that_of_the_corner():
    """A corner at 45° is accepted; at 51° it is refused, though both edges are below 50°."""
    for angle_deg, fits in ((45, True), (51, False)):
        side = math.tan(math.radians(angle_deg)) / math.sqrt(2)
        assert PointSource((side, side)).angle_deg == pytest.approx(angle_deg)
        assert math.degrees(math.atan(side)) < 50
        if fits:
            FieldMap.covering(EVEN, (side, side))
        else:
            with pytest.raises(OptionError, match="deg off the axis"):
                FieldMap.covering(EVEN, (side, side))
