"""The frame's measures: the paper's module, sums of prisms, and what cannot be made."""

import math
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from workpieces import PAPER, frame, inside, resin_of, with_layers

from nolens.camera import Camera, Package, preset
from nolens.errors import OptionError
from nolens.fabricate import FrameGeometry, Printer, frame_solid, shading_angle_deg
from nolens.quantities import Length

AIR = {"thickness": "0.235 mm", "material": "air"}
GLASS = {"name": "cover glass", "thickness": "0.49 mm", "material": "cover-glass"}
RESIN = {"name": "resin", "thickness": "1.06 mm", "material": "pua311"}


def mesh(made: FrameGeometry) -> trimesh.Trimesh:
    solid = frame_solid(made, "test")
    return trimesh.Trimesh(solid.vertices_mm, solid.triangles, process=False)


def test_papers_module() -> None:
    """12.98 × 11.15 × 3 mm."""
    made = FrameGeometry.of(PAPER)
    outer = made.outer_width_mm, made.outer_height_mm, made.height_mm
    assert outer == pytest.approx((12.98, 11.15, 3.0), abs=1e-9)
    assert mesh(made).extents == pytest.approx(outer, abs=1e-6)
    assert made.layer_mm == 1.06 and made.wall_mm == 1 and made.clearance_mm == 0.1


def test_volume_by_hand() -> None:
    """Sum of the prisms of one frame, each worked out on paper."""
    made = frame()
    ring = (13.5 * 11.5 - 10.5 * 8.5) * 3
    mark = 0.5 * 1.0 * 1.0 * 3
    # Each side's triangle 0.5 × 0.5 / 2 along the inner edge, and four corners r³/3.
    rim = 0.125 * 2 * (10.5 + 8.5) + 4 * 0.125 / 3
    # 0.25 deep, 1.5 long, less what the rim took of it: a trapezoid 0.5 and 0.25 long.
    vents = 4 * 1.0 * (0.25 * 1.5 - 0.25 * (0.5 + 0.25) / 2)
    assert made.rim_mm3 == pytest.approx(rim)
    assert made.vents_mm3 == pytest.approx(vents)
    assert made.volume_mm3 == pytest.approx(ring - mark - rim - vents)
    assert made.cavity_mm3 == pytest.approx(10.5 * 8.5 * 3 - 10 * 8 * 2)


def sizes(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high)


@given(
    st.tuples(sizes(2, 30), sizes(2, 30), sizes(0.2, 4), sizes(0.2, 3), sizes(0, 0.5)),
    st.tuples(sizes(0.4, 3), sizes(0, 1), sizes(0.3, 1.5), sizes(0.05, 0.95)),
    st.integers(0, 12),
    sizes(0, 2),
)
@settings(max_examples=80, deadline=None)
def test_solids_are_closed_and_as_large_as_arithmetic_says(
    package: tuple[float, ...], wall: tuple[float, ...], vents: int, mark: float
) -> None:
    thick, rim, width, depth = wall
    try:
        made = FrameGeometry(*package, thick, rim * thick, width, depth * package[3], vents, mark)
    except OptionError:
        assume(False)
    assume(made.rim_mm == 0 or made.rim_mm > 1e-3)
    found = mesh(made)
    assert found.is_watertight and found.is_volume
    assert found.volume == pytest.approx(made.volume_mm3, rel=1e-6)
    assert frame_solid(made, "test").volume_mm3 == pytest.approx(found.volume)
    assert found.body_count == 1


def test_section_through_cavity_and_rim() -> None:
    """What is open at a height: below the rim the inner size, at the top that and twice the rim."""
    made = frame(vents=0)
    for height, wider in ((0.5, 0.0), (2.49, 0.0), (2.75, 0.25), (2.9999, 0.4999)):
        outlines = mesh(made).section([0, 0, 1], [0, 0, height]).discrete
        inside = min((np.ptp(each, axis=0)[:2].tolist() for each in outlines), key=sum)
        assert inside == pytest.approx([10.5 + 2 * wider, 8.5 + 2 * wider], abs=1e-6)


def test_mark_is_at_pixel_0_0_and_vents_are_open() -> None:
    """Seen from the scene, x to the right along the columns and y up along the rows."""
    made = frame()
    solid = frame_solid(made, "test")
    x, y = made.outer_width_mm / 2 - 0.1, made.outer_height_mm / 2 - 0.1
    corners = [[-x, -y, 1], [x, -y, 1], [x, y, 1], [-x, y, 1]]
    assert inside(solid, corners) == [False, True, True, True]
    over = made.height_mm - made.vent_depth_mm / 2
    middle = [[x - 0.3, 0, over], [0, y - 0.3, over], [0.6 - x, 0, over], [0, 0.6 - y, over]]
    assert not any(inside(solid, middle))
    beside = [[a + (0.6 if b else 0), b + (0.6 if a else 0), c] for a, b, c in middle]
    assert all(inside(solid, beside))
    below = [[a, b, c - made.vent_depth_mm] for a, b, c in middle]
    assert all(inside(solid, below))


def test_vents_are_dealt_evenly() -> None:
    offsets = frame(vents=6).vent_offsets_mm()
    assert [len(side) for side in offsets] == [2, 2, 1, 1]
    assert offsets[0] == pytest.approx([-8.5 / 4, 8.5 / 4]) and offsets[2] == (0.0,)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"wall_mm": 0.0}, ["wall (--wall) is 0 mm", "more than 0"]),
        ({"wall_mm": -1.0}, ["--wall"]),
        ({"clearance_mm": -0.1}, ["--clearance", "0 mm or more"]),
        ({"rim_mm": 1.5}, ["rim of 1.5 mm leaves nothing of the wall"]),
        ({"rim_mm": 1.2, "layer_mm": 1.1}, ["rim of 1.2 mm reaches below the glass", "1.1 mm"]),
        ({"vent_depth_mm": 1.0}, ["1 mm deep", "--vent-depth"]),
        ({"vents": -1}, ["-1 vents"]),
        ({"vents": 36}, ["36 vents of 1 mm do not fit", "--vents"]),
        ({"vent_width_mm": 8.5}, ["do not fit"]),
        ({"mark_mm": 2.0}, ["mark of 2 mm cuts through", "less than 2 mm"]),
        ({"package_width_mm": math.inf}, ["--package"]),
    ],
)
def test_impossible_frames(changed: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(OptionError) as refused:
        frame(**changed)
    for word in words:
        assert word in str(refused.value)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"wall_mm": 0.3}, ["wall of 0.3 mm", "smallest feature of 0.4 mm", "--smallest"]),
        ({"rim_mm": 0.7}, ["wall's top of 0.3 mm", "--rim"]),
        ({"vent_width_mm": 0.2}, ["vent of 0.2 mm", "--vent-width"]),
        ({"mark_mm": 1.2}, ["mark leaves"]),
        ({"vents": 32}, ["between vents"]),
        ({"printer": Printer(0.4, (11.0, 50.0))}, ["12.98 × 11.15 mm", "bed of 11 × 50 mm"]),
    ],
)
def test_printer_limits(asked: dict[str, Any], words: list[str]) -> None:
    with pytest.raises(OptionError) as refused:
        FrameGeometry.of(PAPER, **asked)
    for word in words:
        assert word in str(refused.value)


def test_what_a_printer_just_makes() -> None:
    FrameGeometry.of(PAPER, printer=Printer(0.4, (11.15, 12.98)))
    for wall in (0.4, 0.45, 0.5, 0.8, 1.0, 2.0):
        made = FrameGeometry.of(PAPER, wall_mm=wall)
        assert made.seat_mm >= 0.4 - 1e-9 and made.mark_mm > 0
        assert made.mark_room_mm >= 0.4 - 1e-9
    assert FrameGeometry.of(resin_of("0.2 mm", index=1.5)).vent_depth_mm == pytest.approx(0.05)


def test_package() -> None:
    bare = PAPER.model_copy(update={"sensor": PAPER.sensor.model_copy(update={"package": None})})
    with pytest.raises(OptionError, match=r"\[sensor.package\].*--package 12.98mmx11.15mm"):
        FrameGeometry.of(bare)
    given_mm = [Length(each, "mm") for each in ("9", "8", "1.5")]
    package = Package(source="test", width=given_mm[0], height=given_mm[1], glass_top=given_mm[2])
    made = FrameGeometry.of(bare, package=package, clearance_mm=0.2, wall_mm=1.3)
    outer = made.outer_width_mm, made.outer_height_mm, made.height_mm
    assert outer == pytest.approx((9 + 3, 8 + 3, 2.56))


@pytest.mark.parametrize(
    ("layers", "surface", "thickness"),
    [
        ((RESIN, GLASS, AIR), 0, 1.06),
        ((RESIN, GLASS), 0, 1.06),
        ((RESIN,), 0, 1.06),
        ((GLASS, RESIN, GLASS, AIR), 1, 1.06),
    ],
)
def test_poured_layer(layers: tuple[dict[str, Any], ...], surface: int, thickness: float) -> None:
    assert FrameGeometry.of(with_layers(*layers, surface=surface)).layer_mm == thickness


def test_masks_that_are_not_poured() -> None:
    with pytest.raises(OptionError, match="film with air between"):
        FrameGeometry.of(preset("paper-film"))
    for layers in ((GLASS, AIR), (RESIN, RESIN, GLASS, AIR)):
        with pytest.raises(OptionError, match="one layer is poured"):
            FrameGeometry.of(with_layers(*layers))


def traced(camera: Camera, angle_deg: float, room_mm: float, rim_mm: float) -> bool:
    """Whether a ray to the pixel at the edge misses the wall, by Snell's law layer by layer."""
    indices = camera.indices(550.0)
    thicknesses = [1.06, 0.49, 0.235]
    x = 0.0
    for thickness, index in reversed(list(zip(thicknesses[1:], indices[1:], strict=True))):
        x += thickness * math.tan(math.asin(math.sin(math.radians(angle_deg)) / index))
    lean = math.tan(math.asin(math.sin(math.radians(angle_deg)) / indices[0]))
    for step in range(1001):
        depth = 1.06 * step / 1000
        wall = room_mm + max(0.0, rim_mm - depth)
        if x + (1.06 - depth) * lean > wall + 1e-12:
            return False
    return True


def test_shading_is_where_rays_meet_the_wall() -> None:
    for width, height in (("7 mm", "5.2 mm"), ("6.4 mm", "4.8 mm"), ("8 mm", "7 mm")):
        package = Package(
            source="test", width=Length.parse(width), height=Length.parse(height),
            glass_top=Length("1.9", "mm"),
        )  # fmt: skip
        made = FrameGeometry.of(PAPER, package=package)
        angle = shading_angle_deg(PAPER, made)
        assert angle is not None
        room = min(made.inner_width_mm - 6.2868, made.inner_height_mm - 4.712) / 2
        assert traced(PAPER, angle - 0.01, room, made.rim_mm)
        assert not traced(PAPER, angle + 0.01, room, made.rim_mm)


def test_shading_by_the_rims_upper_edge() -> None:
    """Where the resin turns light by so little that it leans more than the rim."""
    camera = resin_of("1.06 mm", index=1.05)
    package = Package(
        source="test", width=Length("9", "mm"), height=Length("7.5", "mm"),
        glass_top=Length("1.9", "mm"),
    )  # fmt: skip
    made = FrameGeometry.of(camera, package=package, wall_mm=2.0, rim_mm=0.8)
    angle = shading_angle_deg(camera, made)
    assert angle is not None
    room = min(made.inner_width_mm - 6.2868, made.inner_height_mm - 4.712) / 2
    lean = math.tan(math.asin(math.sin(math.radians(angle)) / 1.05))
    assert lean > 1
    assert traced(camera, angle - 0.01, room, 0.8)
    assert not traced(camera, angle + 0.01, room, 0.8)


def test_shading_of_others() -> None:
    assert shading_angle_deg(PAPER, FrameGeometry.of(PAPER)) == pytest.approx(78.3, abs=0.1)
    dense = with_layers(RESIN)
    assert shading_angle_deg(dense, FrameGeometry.of(dense)) is None
    over = frame(package_width_mm=5.0, layer_mm=1.06, rim_mm=0.0)
    assert shading_angle_deg(PAPER, over) == 0
